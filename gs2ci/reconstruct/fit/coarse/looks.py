"""The looks at a running fit: how good its views would be if they were delivered now, and the curve of that.

Here: a look, its point of the curve, and the record of what a fit calls while it runs (`Monitoring`). Not here: when a
fit looks (`stage.py`, `paper/fine.py`), when it ends (`stopping.py`).
"""

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.run_figures import CurvePoint
from gs2ci.reconstruct.measurement.holdout import Holdout

Score = Callable[[F32], float]
Decode = Callable[[F32], F32 | None]
"""Decodes what a coded image of the scene, [H, W, C], leaves of the measurement, into what is added to its views,
[N, H, W, C]; None: nothing is."""


def nothing(coded: F32) -> None:
    """Add nothing to views, whatever the coded image."""


@dataclass(frozen=True)
class Monitoring:
    """What a fit calls while it runs, and what may interrupt it.

    Args:
        progress: Called at every iteration.
        since_s: `time.monotonic()` from which the curve's seconds count, as of the whole reconstruction; None: now.
        halt: A request to end early; the fit ends after the iteration in which it is made.
    """

    progress: Progress = field(default_factory=Silent)
    since_s: float | None = None
    halt: Halt = field(default_factory=Halt)


@dataclass(frozen=True)
class LookedAt:
    """What a look judges for one exposure of a fit.

    Args:
        holdout: The measurement and its held-out pixels.
        decode: How views are refined.
        coded: The measurement as the scene predicts it, [H, W, C].
        views: Renders the scene's views, [N, H, W, C].
        score: Turns refined views into a figure for the curve, `psnr_db`; it may know the truth.
    """

    holdout: Holdout
    decode: Decode
    coded: F32
    views: Callable[[], F32]
    score: Score | None = None

    def judged(self) -> tuple[float | None, float | None]:
        """Return the held-out residual of the refined views, and their score; None for what there is not.

        For the coded image only the open pixels of each view are rendered; all of them only if a score asks for them.
        """
        added = self.decode(self.coded)
        heldout = self.holdout.residual_rms_of(self.coded, added)
        if self.score is None:
            return heldout, None
        return heldout, self.score(self.views() if added is None else self.views() + added)


class Looks:
    """Judges a fit's views, and keeps the curve of the results.

    Args:
        since_s: `time.monotonic()` from which the curve's seconds count; None: now.
    """

    def __init__(self, since_s: float | None = None) -> None:
        self.curve: list[CurvePoint] = []
        self._since_s = time.monotonic() if since_s is None else since_s

    def take(self, seen: Iterable[LookedAt], iteration: int, loss: float, gaussians: int) -> float | None:
        """Record one look; return the held-out residual of the refined views, None if no pixel is held out.

        Args:
            seen: Of each exposure, one at least; the residual is that of all together, and the score their mean.
            iteration: How many are done.
            loss: That of the last.
            gaussians: Size of the population.
        """
        judged = [one.judged() for one in seen]
        seconds = time.monotonic() - self._since_s
        heldout = _together([rms for rms, _ in judged], lambda many: math.sqrt(float(np.mean(np.square(many)))))
        psnr_db = _together([score for _, score in judged], lambda many: float(np.mean(many)))
        self.curve.append(CurvePoint(seconds, iteration, loss, heldout, psnr_db, gaussians))
        return heldout


def _together(figures: list[float | None], mean: Callable[[list[float]], float]) -> float | None:
    """Return the mean of the figures that there are, one alone as it is; None if there are none."""
    known = [figure for figure in figures if figure is not None]
    if len(known) > 1:
        return mean(known)
    return known[0] if known else None
