"""The best result within a number of seconds: the time left after decode and geometry is given to the fit.

    registration, decode, geometry ─► a few iterations, timed ─► how many fits, how large ─► fits that watch the clock

Nothing is tried beside the first path, by settings that any run may have. A few iterations of the real fit are then
timed, and the costliest preset is chosen whose fit still gets enough iterations to be worthwhile. The fit adapts its
schedule to its measured pace (`fit/coarse/pace.py`), which corrects errors of this estimate. Polishing by similar
patches knows no deadline: its time, foreseen from one step, is reserved, unless it is too large a part of what is left.

Here: the presets to choose from, the choice, and the sentence about it. Not here: the timing and the fits (`fits`),
reading `60s` (`gs2ci.core.durations`).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numba

from gs2ci.core.durations import spoken_duration
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.choices import LeftOut, PresetName
from gs2ci.reconstruct.fit.coarse.pace import LOOKS_AFTERWARDS, Deadline, Timed, slower_beside
from gs2ci.reconstruct.presets.named import PRESETS, rescheduled
from gs2ci.reconstruct.settings import Settings


@dataclass(frozen=True)
class Rung:
    """A preset, the fewest iterations with which its fits are worthwhile, and the most that they are given."""

    preset: PresetName
    least: int
    most: int


# Costliest first. In the time of fewer than 180 iterations of `standard`, `draft` makes 1.7 times as many and ends up
# to 2 dB better (docs/decisions/schedule.md). `paper` is not among them: it reproduces the paper, and holds out no
# pixels by which to judge it.
LADDER: Final = (Rung("standard", 180, 800), Rung("draft", 20, 600))
# A budget is kept to a tenth; this share is reserved for steps that were not timed.
KEPT_BACK: Final = 0.05
# Drawing the pages of a run folder, closing files and ending the interpreter take so many processor seconds at
# any size; its pictures and figures take as long as this many looks at the held-out pixels.
_ENDING_S: Final = 2.0
_REPORT_LOOKS: Final = 4
# The largest share of the time left that polishing gets. Small parts gain 0.5 to 1.2 dB; where it takes a quarter, fits
# with as many iterations more are as good (`python -m tests.benchmarks budgets`).
_MOST_FOR_POLISH: Final = 0.3


@dataclass(frozen=True)
class Budget:
    """A number of seconds for everything.

    Args:
        seconds: Allowed in total.
        began_s: When the budget began, on `clock`.
        adapt: Sets what presets do not decide (seed, density rule, number of fits) in the settings of a preset.
        clock: The time in seconds; never decreases.
    """

    seconds: float
    began_s: float
    adapt: Callable[[Settings], Settings] = lambda settings: settings
    clock: Callable[[], float] = time.monotonic

    @staticmethod
    def beforehand(settings: Settings) -> Settings:
        """Return settings by which the first path is fitted alone, from one decode: all the time goes to its fits."""
        return replace(
            settings,
            look_again=False,
            long_decode=None,
            fine=None,
            motion="off" if settings.motion == "auto" else settings.motion,
            left_out=(*settings.left_out, LeftOut.DECODE_WEIGHS_NOISE),
        )

    def fit(
        self, settings: Settings, timed: Timed, decode_s: float = 0.0, polish_s: float = 0.0
    ) -> tuple[Settings, Deadline, Finding]:
        """Choose the fits for which the time suffices, and whether their views are polished.

        What was decoded by then is delivered even if no time is left: a fit of one iteration at least then follows.

        Args:
            settings: Of the stages that are done.
            timed: How long the iterations and a look of one fit of `settings` took, with all threads
                and all moments of the masks.
            decode_s: How long the first decode took; the delivered views may need another.
            polish_s: How long polishing the views takes.

        Returns:
            The settings of the fits, the pace that ends them in time, and how the time is divided, or how much would
            have sufficed for a fit that is worthwhile.
        """
        now_s, threads = self.clock(), numba.get_num_threads()
        afterwards_s = _ENDING_S * timed.waiting + _REPORT_LOOKS * timed.look_s + decode_s
        delivered_s = self.began_s + (1 - KEPT_BACK) * self.seconds - afterwards_s
        has_time = polish_s <= _MOST_FOR_POLISH * (delivered_s - now_s)
        for rung in LADDER:
            wanted = self.adapt(PRESETS[rung.preset])
            polish = settings.polish if has_time and wanted.polish is not None else None
            until_s = delivered_s - (0.0 if polish is None else polish_s)
            chosen = replace(settings, fit=wanted.fit, fits=wanted.fits, polish=polish)
            for _ in range(3):  # the first numbers say how often a schedule of that length is looked at
                # A pixel is blended with as many Gaussians as cover it: 1.6 times as many take some 1.2 times as long.
                dearer = slower_beside(chosen.fits, threads) * math.sqrt(_population(chosen) / _population(settings))
                costs = timed.costs(dearer, chosen.fit.mask_moments_from)
                look_every = chosen.fit.hold_out.look_every
                pace = Deadline(rung.most, until_s, costs, timed.look_s, look_every, self.clock)
                iterations = pace.total(0)
                chosen = replace(chosen, fit=rescheduled(chosen.fit, iterations))
            if iterations >= rung.least:
                break
        spent_s = now_s - self.began_s
        shortest_s = 2 * (rung.least * timed.iteration_s + (LOOKS_AFTERWARDS + 1) * timed.look_s) + afterwards_s
        said = finding(
            Code.TIME_DIVIDED if iterations >= rung.least else Code.TIME_TOO_SHORT,
            allowed=spoken_duration(self.seconds),
            spent=spoken_duration(spent_s),
            preset=rung.preset,
            iterations=iterations,
            enough=math.ceil((spent_s + shortest_s) / (1 - KEPT_BACK)),
        )
        return chosen, pace, said


def _population(settings: Settings) -> float:
    """Return the largest number of Gaussians for each pixel of a view; 1 if there is no bound."""
    return settings.fit.gaussians_per_pixel or 1.0
