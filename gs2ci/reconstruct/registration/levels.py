"""What open and closed elements of masks pass, as it is stated: a leak, a vignetting, and noise that is cut off.

Here: these levels, fitted to stated masks. Not here: which elements are open, and how masks were softened (`sharpen`).
"""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from gs2ci.core.arrays import F64, Bool

# Powers of the place, down and right, over which transmissions of open and of closed elements change.
_QUADRATIC: Final = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
# Noise was cut off where more than this share of the elements of one kind is at the end of the range.
_CUT: Final = 0.02
# Open elements pass at least so much more than closed ones; and masks that are closer to 0 and 1 are rounded.
_LEAST_STEP: Final = 0.05
_ROUNDED: Final = 1e-3


@dataclass(frozen=True)
class Levels:
    """What closed elements pass, and what open ones pass more, [H, W]: quadratic in the place, alike in all masks."""

    closed: F64
    step: F64

    @classmethod
    def of(cls, stated: F64, softened: F64, seen: Bool | None = None) -> Self:
        """Fit the stated masks, [N, H, W], by least squares from softened open (1) and closed (0) elements.

        Pixels that do not count may be left out by those that do, [H, W].
        """
        y, x = (np.linspace(-1, 1, side) for side in stated.shape[1:])
        basis = np.stack([np.multiply.outer(y**i, x**j) for i, j in _QUADRATIC])
        counted = np.ones(stated.shape[1:], bool) if seen is None else seen
        gram, moment = np.zeros((2 * len(basis),) * 2), np.zeros(2 * len(basis))
        for mask, elements in zip(stated, softened, strict=True):
            design = np.concatenate([basis, basis * elements])[:, counted]
            gram += design @ design.T
            moment += design @ mask[counted]
        # The smallest solution, if nothing is open.
        found = np.linalg.lstsq(gram, moment, rcond=None)[0]
        closed, step = np.tensordot(found.reshape(2, -1), basis, axes=1)
        return cls(closed, np.maximum(step, _LEAST_STEP))

    @property
    def differ(self) -> bool:
        """Get whether they differ from 0 and 1 by more than rounding."""
        return bool(max(np.abs(self.closed).max(), np.abs(self.step - 1).max()) > _ROUNDED)

    def without_cuts(self, stated: F64, opened: F64) -> Self:
        """Return what elements of crisp masks, [N, H, W], pass; noise cut off at 0 or 1 moves means, but no median."""
        open_ = self.closed + self.step
        closed, open_ = (
            level + _median_beside(stated - level, opened == kind, (stated == end) & (opened == kind))
            for level, kind, end in ((self.closed, 0, 0), (open_, 1, 1))
        )
        return replace(self, closed=closed, step=np.maximum(open_ - closed, _LEAST_STEP))

    @property
    def cut(self) -> bool:
        """Get whether open elements pass more than can be stated."""
        return bool((self.closed + self.step).max() > 1 + _ROUNDED)

    def uncut(self, stated: F64, softened: F64) -> F64:
        """Return stated masks, [N, H, W], with what softened elements pass beyond 1, where they are cut off."""
        return stated + np.maximum(self.given_to(softened) - 1, 0)

    def given_to(self, elements: F64) -> F64:
        """Return the transmissions of elements, [N, H, W], from closed (0) to open (1)."""
        return self.closed + self.step * elements

    def removed_from(self, masks: F64) -> F64:
        """Return from transmissions, [N, H, W], how far elements are open."""
        return (masks - self.closed) / self.step


def _median_beside(deviations: F64, here: Bool, cut: Bool) -> float:
    """Return the median of deviations, [N, H, W], of one kind of elements; 0 if hardly any of these are cut off."""
    return float(np.median(deviations[here])) if cut.sum() > _CUT * here.sum() else 0.0
