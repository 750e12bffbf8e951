"""Misregistration: the modulator's elements do not fall exactly onto the sensor's pixels."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import FiniteFloat
from scipy.ndimage import affine_transform

from gs2ci.core.arrays import F64
from gs2ci.core.config import Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures


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

    stage: ClassVar[LightStage] = LightStage.MASKS
    cost_ns: ClassVar[float] = 60.0

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

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: np.random.Generator) -> F64:
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
