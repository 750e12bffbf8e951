"""The looks at a running fit: what its views would be worth if they were handed over now, and the curve of it.

Here: a look, and its point of the curve. Not here: when a fit looks (`coarse.py`, `fine.py`), and when it ends
(`stopping.py`).
"""

import time
from collections.abc import Callable

from gs2ci.core.arrays import F32
from gs2ci.core.run_records import CurvePoint
from gs2ci.reconstruct.measurement.jury import Jury

Score = Callable[[F32], float]
Refine = Callable[[F32], F32]


class Looks:
    """Judges a fit's views, and keeps what came out.

    Args:
        jury: The measurement and its held-out pixels.
        refine: What will be done to the views, [N, H, W, C], before they are handed over.
        score: Turns refined views into a figure for the curve, in dB; it may know the truth.
        since_s: `time.monotonic()` when the curve's seconds begin; None: now.
    """

    def __init__(self, jury: Jury, refine: Refine, score: Score | None, since_s: float | None) -> None:
        self.curve: list[CurvePoint] = []
        self._jury = jury
        self.refine = refine
        self._score = score
        self._since_s = time.monotonic() if since_s is None else since_s

    def take(self, views: F32, iteration: int, loss: float, gaussians: int) -> float | None:
        """Enter one look; return the held-out residual of the refined views, None where no pixel is held out.

        Args:
            views: The scene's, [N, H, W, C].
            iteration: How many are done.
            loss: That of the last.
            gaussians: Size of the population.
        """
        refined = self.refine(views)
        heldout = self._jury.residual_rms(refined)
        seconds = time.monotonic() - self._since_s
        psnr_db = None if self._score is None else self._score(refined)
        self.curve.append(CurvePoint(seconds, iteration, loss, heldout, psnr_db, gaussians))
        return heldout
