"""How bright each view really was, where the measurement tells that the weights are not those of its exposure.

A lamp on mains flickers between masks, one that warms up drifts, a trigger shortens an interval. The middle view,
carried along the path through its depth, shows what every view should look like. Coded, y = Σᵢ gᵢ wᵢ Mᵢ ⊙ Xᵢ is linear
in the views' brightness g: least squares find it. That brightness from one half of the pixels explains the other half
better, and the other way round, tells whether to believe it; and it has to be the same all over the picture, which what
moves in a scene, or is hidden in some views, is not: standard errors are those of scores summed over blocks.

Weights or scene? Views may have been seen unlike one another because their light was, or because a camera's exposure
drifted; the measurement is the same. `Brightness.as_seen` says what is handed over. Here: that. Not here: the carrying
(`geometry.evidence`), its rounds (`first_look`), the word about uneven brightness before anything is decoded
(`doubts`).
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import LIGHT_MODES, LightMode
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.jury import Jury, surely_larger

# Masks whose normal equations are conditioned worse than this do not tell their views' brightness apart.
TOO_ALIKE: Final = 1e8
# No lamp that anything can be seen by does more between two masks of an exposure.
_RANGE: Final = (0.1, 10.0)
# Halves are a chequerboard of squares this wide: with every colour of a mosaic, and of the scene, in both.
_SQUARE_PX: Final = 2
# So many blocks of a picture, along its mean side, have scores of their own.
_BLOCKS: Final = 5


@dataclass(frozen=True)
class BrightnessSettings:
    """How brightness is found.

    Args:
        rounds: At most so often; 0 takes the weights as they are. Better weights give better views to find it from.
        least_gain: Share by which the residual on pixels that were not asked must fall for weights to be wrong, beside
            being surely smaller, which is enough for them to be corrected further. Where all weights were right it fell
            by up to 0.9 %, where they were 10 % off by 1.2 to 11 (`python -m tests.benchmarks brightness`).
        least_errors: Of its standard errors over blocks, so many the brightness of some view must be away from its
            weight; right weights showed up to 4.0 (up to 2.4 where there was a gain), weights that were 10 % off 8.6
            or more (the same command).
        light: How bright views are handed over: "as-seen"; "even", as under even light; or "auto", even only where
            the shot tells weights, and they are not all alike.
    """

    rounds: int = 3
    least_gain: float = 0.006
    least_errors: float = 4.0
    light: LightMode = "auto"

    def check(self) -> "BrightnessSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: Negative rounds, a gain outside [0, 1], negative errors, or no such light.
        """
        if self.light not in LIGHT_MODES:
            raise InputError(f"light {self.light!r}", allowed=", ".join(LIGHT_MODES))
        if self.rounds < 0 or not 0 <= self.least_gain <= 1 or not self.least_errors >= 0:
            raise InputError(
                f"{self.rounds} rounds for brightness, a least gain of {self.least_gain}, {self.least_errors} errors",
                allowed="rounds >= 0, a gain in [0, 1] and a number of standard errors >= 0",
            )
        return self

    def shows_as_seen(self, weights: F32) -> bool:
        """Tell whether views are handed over as bright as they were seen, and not as under even light.

        Args:
            weights: As the shot tells them, [N]; where those of the lit views are all alike, nobody has measured them.
        """
        if self.light != "auto":
            return self.light == "as-seen"
        lit = weights[weights > 0]
        return bool(lit.min() == lit.max())


@dataclass(frozen=True)
class BrightnessEstimate:
    """What one look says of the views' brightness.

    Args:
        found: For the weights that it was asked with, of mean 1 over their light, [N]; 1 where no light was.
        errors: Standard errors, from scores summed over blocks of the picture, [N].
        gain: Share by which it lowers the residual of pixels that were not asked; 0 unless surely so.
    """

    found: F64
    errors: F64
    gain: float

    @property
    def errors_away(self) -> float:
        """Get by how many of its standard errors the view that is farthest off is away from its weight."""
        known = self.errors > 0
        return float((np.abs(self.found - 1)[known] / self.errors[known]).max(initial=0.0))

    def is_sure(self, settings: BrightnessSettings) -> bool:
        """Tell whether it speaks against weights that nothing has spoken against so far."""
        return self.gain > settings.least_gain and self.errors_away >= settings.least_errors


@dataclass(frozen=True)
class Brightness:
    """What was made of the views' brightness.

    Args:
        first: What the weights as they were given were told; None where nothing tells.
        factors: How bright each view is taken to have been for its weight, [N]; None where the weights stand.
        as_seen: Whether views are handed over as bright as they were seen.
    """

    first: BrightnessEstimate | None = None
    factors: F64 | None = None
    as_seen: bool = True

    @property
    def of_weights(self) -> F64 | None:
        """Get factors of the shot's weights by which they code the views as handed over, [N]; None: as they are."""
        return None if self.as_seen else self.factors

    def shown(self, views: F32) -> F32:
        """Return views of even light, [N, H, W, C], as bright as they are handed over."""
        if self.factors is None or not self.as_seen:
            return views
        lit: F32 = views * self.factors.astype(np.float32)[:, None, None, None]
        return lit

    def summary(self) -> dict[str, Any] | None:
        """Return what the report says; None where nothing could be told."""
        if self.first is None:
            return None
        return {
            "estimated": self.first.found.tolist(),
            "standard_errors": self.first.errors.tolist(),
            "errors_away": self.first.errors_away,
            "explains": self.first.gain,
            "believed": None if self.factors is None else self.factors.tolist(),
            "views": "as-seen" if self.as_seen else "even",
        }


def estimate(jury: Jury, carried: F32) -> BrightnessEstimate | None:
    """BrightnessEstimate the views' brightness, each half of the measurement judging the other's.

    Args:
        jury: The measurement, and its held-out pixels, which are not looked at.
        carried: What every view should look like, [N, H, W, C], all as bright as one of them.

    Returns:
        The estimate; None where nothing tells.
    """
    system = LinearSystem.of(jury.seen, carried)
    found = None if system is None else system.solve()
    if system is None or found is None:
        return None
    errors = np.zeros(len(system.lit))
    errors[system.lit] = system.errors()
    return BrightnessEstimate(system.of_all_views(found), errors, system.gain())


def relit(jury: Jury, found: BrightnessEstimate) -> Jury:
    """Return the measurement with its weights corrected, of the same mean over its masks' light."""
    weights = (jury.shot.weights * found.found).astype(np.float32)
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
        block: To which block of the picture each pixel belongs, [P].
    """

    parts: F64
    readings: F64
    lit: Bool
    light: F64
    half: Bool
    block: NDArray[np.intp]

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
        side = max(_SQUARE_PX, round(np.sqrt(counted.size) / _BLOCKS))
        return cls(
            parts=parts,
            readings=shot.measurement[counted].astype(np.float64),
            lit=lit,
            light=shot.weights[lit] * shot.masks[lit].sum(axis=(1, 2), dtype=np.float64),
            half=np.asarray((row // _SQUARE_PX + column // _SQUARE_PX) % 2 == 0),
            block=np.unique(row // side * counted.shape[1] + column // side, return_inverse=True)[1],
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

    def errors(self) -> F64:
        """Return the standard errors of `solve`, [L], from scores summed over blocks (Liang and Zeger 1986, eq. 2.5).

        What the views leave is alike over the things of a scene, so that pixels alone would flatter.
        """
        parts = self.parts.reshape(len(self.parts), -1)
        inverse = np.linalg.inv(parts @ parts.T)
        found = inverse @ (parts @ self.readings.ravel())
        left = self.readings - np.tensordot(found, self.parts, axes=1)
        by_pixel = (self.parts * left).sum(axis=-1)
        scores = np.stack([np.bincount(self.block, weights=one) for one in by_pixel], axis=1)
        blocks = len(scores)
        spread = inverse @ (scores.T @ scores * (blocks / max(blocks - 1, 1))) @ inverse
        share = self.light / self.light.sum()
        mean = float(found @ share)
        towards_mean = (np.eye(len(found)) - np.outer(found, share) / mean) / mean
        errors: F64 = np.sqrt(np.diagonal(towards_mean @ spread @ towards_mean.T).clip(min=0))
        return errors

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
