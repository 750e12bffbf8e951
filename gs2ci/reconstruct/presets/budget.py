"""The best result within a number of seconds: what is left after decode and geometry goes to the fit.

    registration, decode, geometry ─► a few iterations, timed ─► how many fits, how large ─► fits that watch the clock

Decode and geometry are those of any other run. A few iterations of the real fit are then timed, and the costliest way
to fit is taken for which enough iterations are left to be worth its price. The fit rescales its schedule to the pace
that it turns out to have (`fit/pace.py`), so that errors of this estimate cancel.

Here: the ways to fit, the choice, and what is said of it. Not here: the timing and the fits (`fits`),
reading `60s` (`gs2ci.core.durations`).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numba

from gs2ci.core.durations import spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.fit.pace import LOOKS_AFTERWARDS, Deadline, Timed, slower_beside
from gs2ci.reconstruct.presets.named import PRESETS, rescheduled
from gs2ci.reconstruct.settings import Settings


@dataclass(frozen=True)
class Rung:
    """A preset's fits, the fewest iterations for which they are worth their price, and the most they have a use for."""

    preset: PresetName
    least: int
    most: int


# From the costliest. `paper` is none of them: it is there to be faithful, and has nothing to be judged by.
LADDER: Final = (Rung("fine", 250, 800), Rung("standard", 80, 800), Rung("draft", 20, 600))
# Seconds are promised to a tenth; this share is kept back for what nothing measured.
KEPT_BACK: Final = 0.05
# Closing files, printing, the interpreter's end.
_ENDING_S: Final = 0.5
# Writing a run folder: drawing takes so many seconds of a processor whatever the size, pictures and figures as long as
# so many looks at the held-out pixels.
_DRAWING_S: Final = 1.5
_REPORT_LOOKS: Final = 4
# A population grows while it is fitted, and its iterations get dearer, by as much in the end.
_GROWS_BY: Final = 1.0


@dataclass(frozen=True)
class Budget:
    """A number of seconds for everything.

    Args:
        seconds: Allowed in all.
        began_s: When they began, on `clock`.
        adapt: Brings what no preset decides (seed, density rule, number of fits) into the settings of one.
        clock: The time in seconds; never decreases.
    """

    seconds: float
    began_s: float
    adapt: Callable[[Settings], Settings] = lambda settings: settings
    clock: Callable[[], float] = time.monotonic

    def fit(self, settings: Settings, timed: Timed) -> tuple[Settings, Deadline, str]:
        """Choose the fits for which the time suffices.

        Args:
            settings: Of the stages that are done.
            timed: What iterations and a look of one fit of `settings` took, with all threads.

        Returns:
            The settings of the fits, the pace that ends them in time, and a sentence for the user.

        Raises:
            InputError: Not even the cheapest ends in time; says how many seconds would do.
        """
        now_s = self.clock()
        afterwards_s = (_ENDING_S + _DRAWING_S) * timed.waiting + _REPORT_LOOKS * timed.look_s
        until_s = self.began_s + (1 - KEPT_BACK) * self.seconds - afterwards_s
        for rung in LADDER:
            wanted = self.adapt(PRESETS[rung.preset])
            # The fine stage and the last decode keep to no deadline: the coarse stage gets their time.
            chosen = replace(
                settings, fit=wanted.fit, fits=wanted.fits, stride_px=wanted.stride_px, fine=None, polish=None
            )
            for _ in range(2):  # the first number says how often a schedule of that length is looked at
                iterations = self._pace(rung.most, until_s, timed, settings, chosen).total(0)
                chosen = replace(chosen, fit=rescheduled(chosen.fit, iterations))
            if iterations >= rung.least:
                break
        else:
            raise self._too_little_time(now_s, afterwards_s, timed)
        sentence = (
            f"Of {spoken_duration(self.seconds)}, {spoken_duration(now_s - self.began_s)} went to start, decode and "
            f"geometry: {spoken_duration(until_s - now_s)} are left for the fit of preset {rung.preset}, about "
            f"{iterations} iterations, and {spoken_duration(afterwards_s)} to end and report."
        )
        return chosen, self._pace(rung.most, until_s, timed, settings, chosen), sentence

    def _pace(self, most: int, until_s: float, timed: Timed, of: Settings, chosen: Settings) -> Deadline:
        threads = numba.get_num_threads()
        dearer = slower_beside(chosen.fits, threads) * _population(chosen) / _population(of)
        return Deadline(
            most=most,
            until_s=until_s,
            costs=lambda share: timed.iteration_s * dearer * (1 + _GROWS_BY * share),
            look_s=timed.look_s,
            look_every=chosen.fit.hold_out.look_every,
            clock=self.clock,
        )

    def _too_little_time(self, now_s: float, afterwards_s: float, timed: Timed) -> InputError:
        """Say what the cheapest way would need."""
        spent_s = now_s - self.began_s
        shortest_s = 2 * LADDER[-1].least * timed.iteration_s + 2 * (LOOKS_AFTERWARDS + 1) * timed.look_s
        needed_s = (spent_s + shortest_s + afterwards_s) / (1 - KEPT_BACK)
        return InputError(
            f"{spoken_duration(self.seconds)} are too little: start, decode and geometry took "
            f"{spoken_duration(spent_s)}, the shortest fit takes {spoken_duration(shortest_s)}, the report "
            f"{spoken_duration(afterwards_s)}",
            allowed=f"{math.ceil(needed_s)} s or more for this shot on this machine",
            remedy="`gs2ci decode` recovers the views alone, without a scene, in less",
        )


def _population(settings: Settings) -> float:
    """Return how many Gaussians there are at most, for each pixel of a view; 1 where nothing bounds them."""
    return settings.fit.gaussians_per_pixel or 1.0
