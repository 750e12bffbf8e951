"""The looks at a running fit: how good its views would be if they were delivered now, and the curve of that.

Here: a look, its point of the curve, and the record of what a fit calls while it runs (`Monitoring`). Not here: when a
fit looks (`coarse.py`, `paper/fine.py`), when it ends (`stopping.py`).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from gs2ci.core.arrays import F32
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.run_records import CurvePoint
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
        decode: Its result is added to the scene's views, as before delivery.
        progress: Called at every iteration.
        score: Turns refined views into a figure for the curve, `psnr_db`; it may know the truth.
        since_s: `time.monotonic()` from which the curve's seconds count, as of the whole reconstruction; None: now.
        halt: A request to end early; the fit ends after the iteration in which it is made.
    """

    decode: Decode = nothing
    progress: Progress = field(default_factory=Silent)
    score: Score | None = None
    since_s: float | None = None
    halt: Halt = field(default_factory=Halt)


class Looks:
    """Judges a fit's views, and keeps the curve of the results.

    Args:
        holdout: The measurement and its held-out pixels.
        monitoring: How views are refined and scored, and when the curve's seconds begin.
    """

    def __init__(self, holdout: Holdout, monitoring: Monitoring) -> None:
        self.curve: list[CurvePoint] = []
        self.decode = monitoring.decode
        self._holdout = holdout
        self._score = monitoring.score
        self._since_s = time.monotonic() if monitoring.since_s is None else monitoring.since_s

    def take(self, coded: F32, views: Callable[[], F32], iteration: int, loss: float, gaussians: int) -> float | None:
        """Record one look; return the held-out residual of the refined views, None if no pixel is held out.

        For the coded image only the open pixels of each view are rendered; all of them only if a score asks for them.

        Args:
            coded: The measurement as the scene predicts it, [H, W, C].
            views: Renders the scene's views, [N, H, W, C].
            iteration: How many are done.
            loss: That of the last.
            gaussians: Size of the population.
        """
        added = self.decode(coded)
        heldout = self._holdout.residual_rms_of(coded, added)
        seconds = time.monotonic() - self._since_s
        psnr_db = None
        if self._score is not None:
            psnr_db = self._score(views() if added is None else views() + added)
        self.curve.append(CurvePoint(seconds, iteration, loss, heldout, psnr_db, gaussians))
        return heldout
