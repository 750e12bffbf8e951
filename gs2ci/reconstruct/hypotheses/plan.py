"""What a reconstruction will try, what each hypothesis will cost, and why: foreseen before anything is fitted.

A few iterations are timed, and a step of polishing. The race never lets more than two fits of a still scene reach their
end, so that little is left to chance: the path may be found again, and things may turn out to move.

Here: the plan and its costs. Not here: the race itself (`race`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numba
import numpy as np

from gs2ci.core.durations import spoken_duration
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse.pace import LOOKS_AFTERWARDS, SAMPLES, Timed, slower_beside
from gs2ci.reconstruct.fusion import polish_seconds
from gs2ci.reconstruct.hypotheses.again import is_wanted
from gs2ci.reconstruct.hypotheses.fitting import Fits
from gs2ci.reconstruct.hypotheses.hypothesis import Origin
from gs2ci.reconstruct.hypotheses.race import HALF

# Scenes that move cost so many times as much: each of their Gaussians moves between the masks.
_MOVING_COSTS: Final = 1.3
# Decodes that follow the fits (noise weighed, all pixels), by the seconds of the first; after one by patches there are
# a few last steps alone.
_DECODES_AFTERWARDS: Final = 2.0
_LAST_STEPS: Final = 0.3


@dataclass(frozen=True)
class PlannedStep:
    """One thing that the reconstruction will do, or may do.

    Args:
        what: In words.
        seconds: How long it takes.
        why: In words.
        certain: Whether it will be done in any case.
    """

    what: str
    seconds: float
    why: str
    certain: bool = True


@dataclass(frozen=True)
class RacePlan:
    """The steps in their order.

    Args:
        steps: Certain ones first.
        spent_s: Seconds of all that is done already and will be done again.
    """

    steps: tuple[PlannedStep, ...]
    spent_s: float

    @property
    def seconds(self) -> float:
        """Get the seconds of a whole run, if nothing turns up that is not certain."""
        return self.spent_s + sum(step.seconds for step in self.steps if step.certain)

    @property
    def most_s(self) -> float:
        """Get the seconds of a whole run, if all of it is needed."""
        return self.spent_s + sum(step.seconds for step in self.steps)

    def __str__(self) -> str:
        """Return it as a table in plain text."""
        rows = [("registration, decode, geometry, order of depth", self.spent_s, "before anything is fitted", True)]
        rows += [(step.what, step.seconds, step.why, step.certain) for step in self.steps]
        total = f"about {spoken_duration(self.seconds)}; at most {spoken_duration(self.most_s)}"
        rows.append(("in all", self.seconds, total, True))
        named = [what if certain else f"if: {what}" for what, *_, certain in rows]
        wide = max(map(len, named))
        return "\n".join(
            f"{name:<{wide}} {seconds:7.1f} s  {why}" for name, (_, seconds, why, _) in zip(named, rows, strict=True)
        )


def planned(fits: Fits, first: FirstLook) -> RacePlan:
    """Foresee the race and what follows it.

    Args:
        fits: What all fits share, before any was made.
        first: The first look.
    """
    seconds, timed, count = fits.clock.seconds(), fits.timed(first), max(1, fits.settings.fits)
    alone_s = fit_seconds(fits, timed, 1)
    beside_s = max(0.0, fit_seconds(fits, timed, count) - alone_s)
    steps = [PlannedStep(f"fit along the path of {first.geometry.source}", alone_s, _why(first))]
    steps += _second(fits, first, alone_s, beside_s)
    settings = fits.settings
    polish_s = 0.0 if settings.polish is None else polish_seconds(fits.holdout, first.decoded, settings.polish)
    decodes_s = seconds.get("decode", 0.0) * (_DECODES_AFTERWARDS if first.sigma is None else _LAST_STEPS)
    after_s = polish_s + decodes_s + LOOKS_AFTERWARDS * timed.look_s
    steps.append(PlannedStep("views: residual, polish, decodes, their combination", after_s, "what is delivered"))
    return RacePlan((*steps, *_perhaps(fits, first, alone_s)), seconds["total"])


def _second(fits: Fits, first: FirstLook, alone_s: float, beside_s: float) -> Iterator[PlannedStep]:
    """Yield what is fitted beside the leader: what is most in doubt."""
    settings, count = fits.settings, fits.settings.fits
    if settings.may_look_again and is_wanted(first.geometry, settings.geometry):
        what = f"the path found in its views, or {Origin.COMPANION.value}"
        yield PlannedStep(what, alone_s, "the path is in doubt")
    elif count > 1:
        yield PlannedStep(f"{Origin.COMPANION.value} ({count - 1} more)", beside_s, "the mean of fits errs less")


def _perhaps(fits: Fits, first: FirstLook, alone_s: float) -> Iterator[PlannedStep]:
    """Yield what may join, and when."""
    settings, moving_s = fits.settings, _MOVING_COSTS * alone_s
    if settings.may_move:
        what, why = "a moving scene, half of a fit", "the residual looks like motion"
        yield PlannedStep(what, HALF * moving_s, why, certain=False)
        yield PlannedStep("the moving scene to its end", HALF * moving_s, "half of it explains more", certain=False)
    if settings.long_decode is not None and not first.is_decoded_at_length:
        long_s = polish_seconds(fits.holdout, first.decoded, settings.long_decode.sparse)
        yield PlannedStep("a long decode by patches", long_s, "the scene hardly beats the decode", certain=False)


def fit_seconds(fits: Fits, timed: Timed, beside: int) -> float:
    """Return how long so many whole fits side by side take.

    Args:
        fits: With the schedule.
        timed: Some iterations of it.
        beside: How many.
    """
    fit = fits.settings.fit
    costs = timed.costs(slower_beside(beside, numba.get_num_threads()), fit.mask_moments_from)
    looks = fit.iterations // fit.hold_out.look_every
    iterating_s = fit.iterations * float(np.mean([costs(float(share)) for share in SAMPLES]))
    return float(iterating_s + looks * timed.look_s)


def _why(first: FirstLook) -> str:
    geometry = first.geometry
    if not geometry.has_path:
        return "no path was found"
    expected = geometry.path_error_expected
    return "it explains the measurement best" if expected is None else f"its path errs by about {expected:.1%}"
