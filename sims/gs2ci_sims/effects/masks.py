"""Effects on masks: what they are at the sensor, beside what was sent to the modulator.

- Finite contrast: a closed element still lets some light through, unevenly over the modulator.
- Mask edges: an element's transmission changes gradually at its edge.
- Misregistration: the modulator's elements do not fall exactly onto the sensor's pixels.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat
from scipy.ndimage import affine_transform, gaussian_filter

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.effects.kernels import blurred, gaussian_tail
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class FiniteContrast(EffectRecord):
    """Raise the off level of the masks to a map of leakage: M becomes leak + (1 - leak) M.

    The leakage is log-normal over the field, a fixed pattern of the device. Measured masks of two laboratory
    systems have a median off level of 0.040 and 0.042, 0.017 to 0.083 from the 10th to the 90th percentile: a
    contrast of 25 with a spread of ln(0.083 / 0.017) / 2.56 = 0.62.

    Args:
        contrast: On over off, median over the field, more than 1.
        spread: Standard deviation of the leakage's logarithm, 0 to 2.
        patch_px: Scale over which the leakage varies, pixels, at least 0.
    """

    stage = LightStage.MASKS
    cost_ns = 10.0
    fixed_pattern = True

    contrast: Annotated[float, Field(gt=1)] = 25.0
    spread: Annotated[float, Field(ge=0, le=2)] = 0.62
    patch_px: NotNegative = 4.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The light that passes all closed elements by this device's map of leakage."""
        return scene.of_mask_effect(self).after(
            BoundStep("C", self.contrast, "", "contrast, median over the field"),
            BoundStep("leak", 1 / self.contrast, "", "off level there; a mask M becomes leak + (1 - leak) M", "1 / C"),
            BoundStep("spread", self.spread, "", "standard deviation of its logarithm over the field"),
        )

    def leakage(self, size: tuple[int, int], rng: Rng) -> F64:
        """Draw the device's map of off levels, [H, W] in [0, 1]."""
        pattern = gaussian_filter(rng.standard_normal(size), self.patch_px, mode="wrap")
        deviation = float(pattern.std())
        pattern = (pattern - pattern.mean()) / deviation if deviation > 0 else np.zeros(size)
        return np.minimum(np.exp(self.spread * pattern) / self.contrast, 1.0)

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: Rng) -> F64:
        """Raise the off level of masks [N, H, W]."""
        leak = self.leakage((signal.shape[1], signal.shape[2]), rng)
        return leak + (1 - leak) * signal.astype(np.float64)


@dataclass(frozen=True)
class MaskEdges(EffectRecord):
    """Blur the masks themselves by a Gaussian: gaps between mirrors, fringing fields between cells.

    A Gaussian of about 0.5 px fits two measured sets of laboratory masks against their binarised copies.

    Args:
        sigma_px: Standard deviation in sensor pixels, 0 to 100.
        reach: Where the kernel is cut off, in standard deviations; the planner chooses.
    """

    stage = LightStage.MASKS
    cost_ns = 20.0

    sigma_px: Annotated[float, Field(ge=0, le=100)] = 0.5
    reach: Annotated[float, Field(gt=0, le=10)] = 8.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change by the blur of the masks that reach it."""
        sigma = BoundStep("sigma", self.sigma_px, "px", "standard deviation of the blur of the masks")
        return scene.of_mask_effect(self).after(sigma)

    def kernel_bound(self, scene: Previewed, rig: RigFigures, reach: float) -> Bound:
        """The masks' deviation from their mean, times twice the truncated share of the kernel, per direction.

        Each mask's change counts at the brightest light, and changes of different masks do not cancel.
        """
        tail = gaussian_tail(self.sigma_px, reach)
        deviation = float(scene.masks.std(axis=(1, 2), dtype=np.float64).sum())
        light = 4 * tail * scene.full_scale_dn * scene.scene.brightest
        return Bound(light * deviation, light * len(scene.masks))

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: Rng) -> F64:
        """Blur masks [N, H, W]."""
        return self._blurred(signal, self.reach)

    def _blurred(self, masks: NDArray[np.floating], reach: float) -> F64:
        return np.stack([blurred(mask.astype(np.float64), self.sigma_px, reach) for mask in masks])


@dataclass(frozen=True)
class Misregistration(EffectRecord):
    """Move the masks by an affine map about the middle of the sensor.

    Elements and pixels are squares of one pitch: the overlap of a shifted element with a pixel is bilinear in the
    shift, so bilinear interpolation is exact for it. Beyond its border the modulator continues as at the border.

    Args:
        right_px: Shift of the masks to the right, sensor pixels.
        down_px: Shift down.
        turn_mrad: Rotation, right-hand side down.
        magnification: Magnification of the masks on the sensor, more than 0.
    """

    stage = LightStage.MASKS
    cost_ns = 60.0

    right_px: FiniteFloat = 0.0
    down_px: FiniteFloat = 0.0
    turn_mrad: FiniteFloat = 0.0
    magnification: Positive = 1.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change of each mask that reaches it."""
        return scene.of_mask_effect(self).after(
            BoundStep("x", self.right_px, "px", "shift of the masks to the right"),
            BoundStep("y", self.down_px, "px", "shift down"),
            BoundStep("turn", self.turn_mrad, "mrad", "turn"),
            BoundStep("scale", self.magnification, "", "magnification"),
        )

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: Rng) -> F64:
        """Move masks [N, H, W]."""
        return self._moved(signal)

    def _moved(self, masks: NDArray[np.floating]) -> F64:
        turn = 1e-3 * self.turn_mrad
        sensor_from_mask = self.magnification * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        mask_from_sensor = np.linalg.inv(sensor_from_mask)
        middle = 0.5 * (np.array(masks.shape[1:]) - 1)
        offset = middle - mask_from_sensor @ (middle + np.array([self.down_px, self.right_px]))
        moved = [
            affine_transform(mask.astype(np.float64), mask_from_sensor, offset, order=1, mode="nearest")
            for mask in masks
        ]
        return np.clip(moved, 0.0, 1.0)
