"""How bright each view really was, where the measurement tells that the weights are not those of its exposure.

A lamp on mains flickers between masks, one that warms up drifts, a trigger shortens an interval. The middle view,
carried along the path through its depth, shows what every view should look like. Coded, y = Σᵢ gᵢ wᵢ Mᵢ ⊙ Xᵢ is linear
in the views' brightness g: least squares find it. That brightness from one half of the pixels explains the other half
better, and the other way round, tells whether to believe it. Here: that. Not here: the carrying (`geometry.evidence`),
its rounds (`first_look`), the word about uneven brightness before anything is decoded (`doubts`). For
`gs2ci.reconstruct`.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.jury import Jury, surely_larger

# Masks whose normal equations are conditioned worse than this do not tell their views' brightness apart.
TOO_ALIKE: Final = 1e8
# No lamp that anything can be seen by does more between two masks of an exposure.
_RANGE: Final = (0.1, 10.0)
# Halves are a chequerboard of squares this wide: with every colour of a mosaic, and of the scene, in both.
_SQUARE_PX: Final = 2


@dataclass(frozen=True)
class BrightnessSettings:
    """How brightness is found.

    Args:
        rounds: At most so often; 0 takes the weights as they are. Better weights give better views to find it from.
        least_gain: Share by which the residual on pixels that were not asked must fall for weights to be wrong, beside
            being surely smaller, which is enough for them to be corrected further. Where all weights were right it fell
            by up to 0.3 %, where they were 10 % off by 1.2 to 11 (`python -m tests.benchmarks brightness`).
    """

    rounds: int = 3
    least_gain: float = 0.006

    def check(self) -> "BrightnessSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: Negative rounds, or a gain outside [0, 1].
        """
        if self.rounds < 0 or not 0 <= self.least_gain <= 1:
            raise InputError(
                f"{self.rounds} rounds for brightness, a least gain of {self.least_gain}",
                allowed="rounds >= 0 and a gain in [0, 1]",
            )
        return self


def relit(jury: Jury, carried: F32, least_gain: float) -> Jury | None:
    """Correct the weights by the brightness that the measurement shows, if each half of it agrees with the other's.

    Args:
        jury: The measurement, and its held-out pixels, which are not looked at.
        carried: What every view should look like, [N, H, W, C], all as bright as one of them.
        least_gain: See `BrightnessSettings`.

    Returns:
        The measurement with other weights, of the same mean over its masks' light; None where nothing is to be
        corrected, or nothing tells.
    """
    system = LinearSystem.of(jury.seen, carried)
    if system is None or system.gain() <= least_gain:
        return None
    found = system.solve()
    if found is None:
        return None
    weights = (jury.shot.weights * system.of_all_views(found)).astype(np.float32)
    return Jury(replace(jury.shot, weights=weights), jury.heldout)


@dataclass(frozen=True)
class LinearSystem:
    """The linear system that the views' brightness solves.

    Build it with `of`.

    Args:
        parts: What each lit view adds to each pixel that counts, [L, P, C].
        readings: What those pixels read, [P, C].
        lit: Which views light reached, [N].
        light: How much, [L].
        half: Which pixels belong to the first half, [P].
    """

    parts: F64
    readings: F64
    lit: Bool
    light: F64
    half: Bool

    @classmethod
    def of(cls, shot: Shot, views: F32) -> "LinearSystem | None":
        """Set the system up; None with fewer than two lit views, or with views that are not finite.

        Args:
            shot: The measurement as far as it may be seen; saturated pixels do not count.
            views: What every view should look like, [N, H, W, C].
        """
        lit = np.asarray((shot.weights[:, None, None] * shot.masks).any(axis=(1, 2)))
        if lit.sum() < 2 or not np.isfinite(views).all():
            return None
        counted = np.asarray(shot.masks.any(axis=0))
        if shot.saturated is not None:
            counted &= ~shot.saturated
        coding = Coding.of(shot)
        parts = np.stack([_part(coding, views, int(view))[counted] for view in np.flatnonzero(lit)])
        row, column = np.nonzero(counted)
        return cls(
            parts=parts,
            readings=shot.measurement[counted].astype(np.float64),
            lit=lit,
            light=shot.weights[lit] * shot.masks[lit].sum(axis=(1, 2), dtype=np.float64),
            half=np.asarray((row // _SQUARE_PX + column // _SQUARE_PX) % 2 == 0),
        )

    def solve(self, pixels: Bool | slice = slice(None)) -> F64 | None:
        """Find the brightness of the lit views, [L], of mean 1 over their light, from some of the pixels.

        None where masks do not tell views apart, or a factor is beyond what a lamp does.
        """
        parts = self.parts[:, pixels].reshape(len(self.parts), -1)
        normal = parts @ parts.T
        if not np.isfinite(normal).all() or np.linalg.cond(normal) > TOO_ALIKE:
            return None
        found = np.linalg.solve(normal, parts @ self.readings[pixels].ravel())
        mean = float((found * self.light).sum() / self.light.sum())
        if mean <= 0 or not _RANGE[0] * mean <= found.min() <= found.max() <= _RANGE[1] * mean:
            return None
        return np.asarray(found / mean, np.float64)

    def gain(self) -> float:
        """Return by which share each half's brightness lowers the other half's residual; 0 unless surely so."""
        before, after = self._squares(np.ones(len(self.parts)), slice(None)), np.empty(len(self.readings))
        for asked in (self.half, ~self.half):
            found = self.solve(asked)
            if found is None:
                return 0.0
            after[~asked] = self._squares(found, ~asked)
        if not surely_larger(before, after):
            return 0.0
        return float(1 - np.sqrt(after.mean() / before.mean()))

    def _squares(self, brightness: F64, pixels: Bool | slice) -> F64:
        """Return squared residuals of pixels, summed over their channels."""
        left = self.readings[pixels] - np.tensordot(brightness, self.parts[:, pixels], axes=1)
        squares: F64 = (left**2).sum(axis=-1)
        return squares

    def of_all_views(self, found: F64) -> F64:
        """Return the brightness of all views, [N], from that of the lit ones; 1 where no light was."""
        brightness = np.ones(len(self.lit))
        brightness[self.lit] = found
        return brightness


def _part(coding: Coding, views: F32, view: int) -> F64:
    """Return what one view adds to the measurement, [H, W, C]."""
    alone = Coding(coding.transmissions[view : view + 1], coding.channels)
    part: F64 = alone.forward(torch.from_numpy(views[view : view + 1])).numpy().astype(np.float64)
    return part
