"""Bounds over all masks of what changing light does to a measurement: sums of weighted fields at their worst alignment.

An effect changes the light behind mask n by a field R_n, of which its rms rho_n over the pixels and its peak P are
known, but not where it is large; the mask lets w_n >= 0 of it through. The reading then changes by sum_n w_n R_n, and
the fields may be largest exactly where the masks are open, and may cancel or not. Two limits hold for every set of
masks, and the smaller one counts:

- One mask after the other (triangle inequality). With R^2 <= P^2 and mean R^2 = rho^2, the mean of w^2 R^2 is largest
  where R has its peak on the pixels of largest w, a share (rho / P)^2 of all: it is rho^2 times the mean of w^2 there.
- All together (Cauchy and Schwarz, pixel by pixel): |sum w_n R_n| <= A B with A^2 = sum w_n^2, B^2 = sum R_n^2, and B
  has the rms (sum rho_n^2)^(1/2) and a peak of P N^(1/2). It is the better one where few masks are open at a pixel.

Not here: which fields (`preview`, effects).
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import f64, f64_1, kernel

# Weights are counted in so many steps, each taken for its upper end.
STEPS: Final = 512
# By which rounding moves a weight beyond a step, in steps: of float64 and of float32.
_TOLERANCE: Final = 1e-9
_TOLERANCE_OF_SINGLES: Final = 1e-4


class TopMean:
    """How large the mean square of weights can be over a share of the pixels.

    Args:
        weights: At least 0, of any shape.
    """

    def __init__(self, weights: NDArray[Any]) -> None:
        self.largest = float(weights.max(initial=0.0))
        step = self.largest / STEPS or 1.0
        # The tolerance keeps a weight that is a step but for rounding from counting as the next one.
        tolerance = _TOLERANCE_OF_SINGLES if weights.dtype == np.float32 else _TOLERANCE
        shares, sums = np.zeros(STEPS + 2), np.zeros(STEPS + 2)
        _add_up(np.ascontiguousarray(weights, np.float64).ravel(), step, tolerance, shares, sums)
        self._shares, self._sums = shares, sums

    def worst_rms(self, rms: float, peak: float) -> float:
        """Return the largest rms of weights times a field of this rms and peak; the peak is at least the rms."""
        if rms <= 0 or peak <= 0:
            return 0.0
        share = min(1.0, (rms / peak) ** 2)
        # Below the resolution of shares, the largest weight is the mean.
        mean_square = float(np.interp(share, self._shares, self._sums)) / share if share > 1e-12 else self.largest**2
        return rms * min(float(np.sqrt(mean_square)), self.largest)


@kernel(f64_1, f64, f64, f64_1, f64_1)
def _add_up(weights, step, tolerance, shares, sums):  # type: ignore[no-untyped-def]
    """Store which share of the weights is at least each step, from the largest down, and the sum of their squares.

    Compiled: the passes of numpy over a small mask, and their calls, take several times as long.

    Args:
        weights: [P].
        step: Between the steps.
        tolerance: By which a weight may be beyond a step, in steps.
        shares: Written: [STEPS + 2], from 0.
        sums: Written: likewise.
    """
    counts = np.zeros(STEPS + 1, np.int64)
    for index in range(len(weights)):
        counts[min(max(int(np.ceil(weights[index] / step - tolerance)), 0), STEPS)] += 1
    for place in range(STEPS + 1):
        share = counts[STEPS - place] / max(len(weights), 1)
        value = (STEPS - place) * step
        shares[place + 1] = shares[place] + share
        sums[place + 1] = sums[place] + share * (value * value)


class WeightSet:
    """The weights of one set of masks, counted once for many fields.

    Args:
        weights: One image [H, W] per mask, at least 0.
        singly: False: no fields will be asked about one by one; saves the counting.
    """

    def __init__(self, weights: Iterable[NDArray[Any]], *, singly: bool = True) -> None:
        self._each: list[TopMean] = []
        total: F64 | float = 0.0
        squares: F64 | float = 0.0
        for image in weights:
            if singly:
                self._each.append(TopMean(image))
            total = total + image.astype(np.float64)
            squares = squares + np.square(image, dtype=np.float64)
        self._sum = TopMean(np.asarray(total))
        self._together = TopMean(np.sqrt(squares))
        self.largest_sum = self._sum.largest

    def worst_rms(self, rms: F64, peak: float) -> float:
        """Return the largest rms of sum_n w_n R_n for fields of these rms values, [N], and of this peak."""
        by_turns = sum(top.worst_rms(float(one), peak) for top, one in zip(self._each, rms, strict=True))
        joint = float(np.sqrt(np.square(rms).sum()))
        return min(by_turns, self._together.worst_rms(joint, peak * len(self._each) ** 0.5))

    def worst_rms_of_independent(self, rms: float, peak: float) -> float:
        """Return the largest rms if the fields are independent draws: variances add up, so of (sum w^2)^(1/2)."""
        return self._together.worst_rms(rms, peak)

    def worst_rms_of_one(self, rms: float, peak: float) -> float:
        """Return the largest rms if the field is the same behind all masks: of sum_n w_n times it."""
        return self._sum.worst_rms(rms, peak)
