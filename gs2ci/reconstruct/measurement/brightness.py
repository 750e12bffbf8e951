"""The true brightness of each view, estimated from the measurement when the stated weights are wrong.

A lamp on mains flickers between masks, one that warms up drifts, a trigger shortens an interval. The middle view,
warped to the other poses by its depth, predicts every view. Coded, y = Σᵢ gᵢ wᵢ Mᵢ ⊙ Xᵢ is linear in the views'
brightness g, which is found by least squares. Where predictions are displaced, or carry the pattern of their masks,
that is biased: views whose detail explains little seem darker, and the middle one, which nobody warps, brighter.
Smoothed predictions err less, but tell less; where the two estimates differ surely, they are believed (Hausman
1978). Two checks decide whether it is accepted. The brightness from one half of
the pixels must explain the other half better, and vice versa. And it must be the same all over the picture, unlike the
effect of moving or occluded things: so standard errors come from scores summed over blocks.

Weights or scene? Views may differ in brightness because the scene's light changed, or because the camera's exposure
drifted; the measurement is the same. `Brightness.as_seen` decides which brightness the delivered views have. Here: all
that. Not here: the warping (`geometry.evidence`), the rounds (`first_look`), the warning about uneven brightness before
anything is decoded (`doubts`).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt
from torch import Tensor

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.bounds import Bounded
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import LightSection
from gs2ci.reconstruct.choices import LightMode
from gs2ci.reconstruct.measurement.blocks import block_numbers, scores_over_blocks
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.holdout import Holdout, surely_larger
from gs2ci.render.places import work_place

# If the condition number of the normal equations is larger, the masks do not distinguish their views' brightness.
TOO_ALIKE: Final = 1e8
# Pairs of masks that are open where the other is closed open as much together as any other pair, so that nothing tells
# the light of one pair from that of another: a mode of brightness in which all masks together pass less than this share
# of what one passes (mean square). In random masks it is 0.5 with a half open, 0.02 with 98 %.
_LEAST_TOLD: Final = 1e-3
# A usable lamp does not vary by more between the masks of an exposure.
_RANGE: Final = (0.1, 10.0)
# Predictions are smoothed by this standard deviation, px. If a view's brightness then differs by more than so many
# standard errors, that from sharp predictions is biased.
_SMOOTH_PX: Final = 4.0
_BIASED: Final = 3.0
# Halves are a chequerboard of squares this wide, so that both contain every colour of a mosaic and of the scene.
_SQUARE_PX: Final = 2
# Number of blocks, along the mean side of a picture, over which scores are summed.
_BLOCKS: Final = 5


@dataclass(frozen=True)
class BrightnessSettings(Bounded):
    """How brightness is estimated.

    Args:
        rounds: At most so many rounds; 0 uses the weights as they are. Better weights give better views for the next
            round.
        least_gain: Share by which the residual at pixels of the other half must decrease for weights to be corrected
            for the first time; for further corrections a sure decrease is enough. With right weights it decreased by up
            to 0.9 %, with weights 10 % off by 1.2 to 11 (`python -m tests.benchmarks brightness`).
        least_errors: By so many standard errors over blocks the brightness of some view must differ from its weight;
            right weights showed up to 4.0 (up to 2.4 if there was a gain), weights 10 % off 8.6 or more (the same
            command).
        light: Brightness of the delivered views: "as-seen"; "even", as under even light; or "auto", even only if the
            shot states weights that are not all alike.
    """

    rounds: NonNegativeInt = 3
    least_gain: Annotated[float, Field(ge=0, le=1)] = 0.006
    least_errors: Annotated[float, Field(ge=0)] = 4.0
    light: LightMode = "auto"

    def shows_as_seen(self, weights: F32) -> bool:
        """Tell whether delivered views are as bright as they were seen, and not as under even light.

        Args:
            weights: As the shot states them, [N]; if those of the lit views are all alike, they were not measured.
        """
        if self.light != "auto":
            return self.light == "as-seen"
        lit = weights[weights > 0]
        return bool(lit.min() == lit.max())


@dataclass(frozen=True)
class BrightnessEstimate:
    """One estimate of the views' brightness.

    Args:
        found: Factors of the present weights, of mean 1 over their light, [N]; 1 for views without light.
        errors: Standard errors, from scores summed over blocks of the picture, [N].
        gain: Share by which it reduces the residual of the other half's pixels; 0 unless surely so.
    """

    found: F64
    errors: F64
    gain: float

    @property
    def errors_away(self) -> float:
        """Get the largest difference of a view's brightness from its weight, in standard errors."""
        known = self.errors > 0
        return float((np.abs(self.found - 1)[known] / self.errors[known]).max(initial=0.0))

    def is_sure(self, settings: BrightnessSettings) -> bool:
        """Tell whether it is sure enough to correct weights for the first time."""
        return self.gain > settings.least_gain and self.errors_away >= settings.least_errors


@dataclass(frozen=True)
class Brightness:
    """The views' brightness, and the corrections by it.

    Args:
        first: The estimate with the given weights; None if it is not possible.
        factors: Brightness of each view relative to its weight, [N]; None if the weights are kept.
        as_seen: Whether delivered views are as bright as they were seen.
    """

    first: BrightnessEstimate | None = None
    factors: F64 | None = None
    as_seen: bool = True

    @property
    def of_weights(self) -> F64 | None:
        """Get factors of the shot's weights for coding the delivered views, [N]; None: the weights as they are."""
        return None if self.as_seen else self.factors

    def shown(self, views: F32) -> F32:
        """Return views of even light, [N, H, W, C], with the brightness of the delivered ones."""
        if self.factors is None or not self.as_seen:
            return views
        return views * self.factors.astype(np.float32)[:, None, None, None]

    def summary(self) -> LightSection | None:
        """Return the figures for the report; None if there is no estimate."""
        if self.first is None:
            return None
        return LightSection(
            estimated=self.first.found.tolist(),
            standard_errors=self.first.errors.tolist(),
            errors_away=self.first.errors_away,
            explains=self.first.gain,
            used=None if self.factors is None else self.factors.tolist(),
            views="as-seen" if self.as_seen else "even",
        )


def estimate(holdout: Holdout, carried: F32) -> BrightnessEstimate | None:
    """Estimate the views' brightness; each half of the measurement judges the estimate of the other.

    Args:
        holdout: The measurement, and its held-out pixels, which are not used.
        carried: Prediction of every view, [N, H, W, C], all with the same brightness.

    Returns:
        The estimate; None if it is not possible.
    """
    system = LinearSystem.of(holdout.seen, carried)
    found = None if system is None else system.solve()
    if system is None or found is None:
        return None
    believed, errors = system, system.errors()
    smooth = LinearSystem.of(holdout.seen, _smoothed(carried))
    other = None if smooth is None else smooth.solve()
    if smooth is not None and other is not None:
        its_errors = smooth.errors()
        if (np.abs(other - found) > _BIASED * its_errors).any():
            believed, found, errors = smooth, other, its_errors
    del smooth  # a system is twice as large as the views
    of_all = np.zeros(len(system.lit))
    of_all[system.lit] = errors
    return BrightnessEstimate(system.of_all_views(found), of_all, system.gain(believed))


def _smoothed(views: F32) -> F32:
    """Smooth views, [N, H, W, C]; one by one, since OpenCV takes four channels at most."""
    smooth = [cv2.GaussianBlur(view, (0, 0), _SMOOTH_PX, borderType=cv2.BORDER_REFLECT) for view in views]
    return np.stack(smooth).reshape(views.shape)


def relit(holdout: Holdout, found: BrightnessEstimate) -> Holdout:
    """Return the measurement with corrected weights, whose mean over its masks' light is unchanged."""
    weights = holdout.shot.weights_by(found.found)
    return Holdout(replace(holdout.shot, weights=weights), holdout.pixels)


@dataclass(frozen=True)
class LinearSystem:
    """The linear system for the views' brightness, on a device where one works.

    Build it with `of`.

    Args:
        parts: Contribution of each lit view to each pixel that counts, [L, P, C].
        readings: Readings of those pixels, [P, C].
        lit: Which views got light, [N].
        light: Amount of light of each, [L].
        half: Which pixels belong to the first half, [P].
        block: The block of the picture to which each pixel belongs, [P].
        told: Modes of brightness in which the masks tell views apart, [L, R].
    """

    parts: Tensor
    readings: Tensor
    lit: Bool
    light: F64
    half: Tensor
    block: NDArray[np.intp]
    told: F64

    @classmethod
    def of(cls, shot: Shot, views: F32) -> "LinearSystem | None":
        """Set the system up; None with fewer than two lit views, or with views that are not finite.

        Args:
            shot: The measurement without its held-out pixels; saturated pixels do not count.
            views: Prediction of every view, [N, H, W, C].
        """
        lit = np.asarray(shot.transmissions.any(axis=(1, 2)))
        if lit.sum() < 2 or not np.isfinite(views).all():
            return None
        counted = shot.usable
        told = told_modes(shot.masks[:, counted][lit])
        coding, place = Coding.of(shot), work_place()
        asked = torch.from_numpy(counted).to(place)
        readings = torch.from_numpy(shot.measurement).to(place)[asked].double()
        parts = readings.new_empty(int(lit.sum()), *readings.shape)
        for part, view in zip(parts, np.flatnonzero(lit), strict=True):
            alone = Coding(coding.transmissions[[view]].to(place), coding.channels)
            part[:] = alone.forward(torch.from_numpy(views[[view]]).to(place))[asked]
        row, column = np.nonzero(counted)
        side = max(_SQUARE_PX, round(np.sqrt(counted.size) / _BLOCKS))
        return cls(
            parts=parts,
            readings=readings,
            lit=lit,
            light=shot.weights[lit] * shot.masks[lit].sum(axis=(1, 2), dtype=np.float64),
            half=torch.from_numpy((row // _SQUARE_PX + column // _SQUARE_PX) % 2 == 0).to(place),
            block=block_numbers(row, column, side),
            told=told,
        )

    def solve(self, pixels: Tensor | slice = slice(None)) -> F64 | None:
        """Return the brightness of the lit views, [L], of mean 1 over their light, from some of the pixels.

        None if masks do not distinguish the views, or a factor is outside a lamp's range.
        """
        normal, right = self._normal(pixels)
        # In all other modes the brightness is that of the weights.
        right = self.told.T @ (right - normal.sum(axis=1))
        normal = self.told.T @ normal @ self.told
        if len(normal) < 2 or not np.isfinite(normal).all() or np.linalg.cond(normal) > TOO_ALIKE:
            return None
        found = 1 + self.told @ np.linalg.solve(normal, right)
        mean = float((found * self.light).sum() / self.light.sum())
        if mean <= 0 or not _RANGE[0] * mean <= found.min() <= found.max() <= _RANGE[1] * mean:
            return None
        return found / mean

    def _normal(self, pixels: Tensor | slice = slice(None)) -> tuple[F64, F64]:
        """Return the normal matrix of some pixels, [L, L], and its right side, [L]."""
        parts = self.parts[:, pixels].reshape(len(self.parts), -1)
        return (parts @ parts.T).cpu().numpy(), (parts @ self.readings[pixels].reshape(-1)).cpu().numpy()

    def _left(self, brightness: F64) -> Tensor:
        """Return what views of some brightness, [L], leave of the readings, [P, C]."""
        return self.readings - torch.tensordot(torch.from_numpy(brightness).to(self.parts.device), self.parts, dims=1)

    def errors(self) -> F64:
        """Return the standard errors of `solve`, [L], from scores summed over blocks.

        Residuals are correlated over the things of a scene, so that errors from single pixels would be too small.
        """
        normal, right = self._normal()
        inverse = self.told @ np.linalg.inv(self.told.T @ normal @ self.told) @ self.told.T
        found = 1 + inverse @ (right - normal.sum(axis=1))
        left = self._left(found)
        by_pixel = torch.stack([(part * left).sum(dim=-1) for part in self.parts]).cpu().numpy()
        spread = inverse @ scores_over_blocks(by_pixel, self.block) @ inverse
        share = self.light / self.light.sum()
        mean = float(found @ share)
        towards_mean = (np.eye(len(found)) - np.outer(found, share) / mean) / mean
        return np.sqrt(np.diagonal(towards_mean @ spread @ towards_mean.T).clip(min=0))

    def gain(self, solver: "LinearSystem | None" = None) -> float:
        """Return the share by which each half's brightness reduces the other half's residual; 0 unless surely so.

        Args:
            solver: The system that gives each half's brightness, if it is another one.
        """
        one, other = ((solver or self).solve(half) for half in (~self.half, self.half))
        if one is None or other is None:
            return 0.0
        squares = (self._left(found).square().sum(dim=-1) for found in (np.ones(len(one)), one, other))
        before, first, second = (some.cpu().numpy() for some in squares)
        after = np.where(self.half.cpu().numpy(), first, second)
        if not surely_larger(before, after):
            return 0.0
        return float(1 - np.sqrt(after.mean() / before.mean()))

    def of_all_views(self, found: F64) -> F64:
        """Return the brightness of all views, [N], from that of the lit ones; 1 for views without light."""
        brightness = np.ones(len(self.lit))
        brightness[self.lit] = found
        return brightness


def told_modes(masks: F32) -> F64:
    """Return the modes of brightness, [L, R], in which masks, [L, P], L at least 1, tell views apart."""
    opened = torch.from_numpy(masks).to(work_place()).double()
    shares, modes = np.linalg.eigh((opened @ opened.T).cpu().numpy())
    return modes[:, shares >= _LEAST_TOLD * shares.mean()]
