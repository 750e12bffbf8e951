"""Where the modulator's pixels fall on the sensor, and what of them each sensor pixel sees.

Here: the true map between the two grids and the integral over each sensor pixel's square. Not here: blur, leakage
(`effects`), measuring the map (`gs2ci_calibration`).
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F32, F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.errors import InputError
from gs2ci_sims.world import MaskInterval

# A sensor pixel's square, turned by this much, is integrated as an upright one: the corners are then off by less
# than 0.03 of its side.
TURN_LIMIT_MRAD = 50.0


@dataclass(frozen=True)
class MaskAlignment(BoundedRecord):
    """Which modulator pixels a sensor pixel sees: nominally a block of k × k, all blocks side by side.

    The image of the modulator is first mirrored, then turned in quarters, both about the sensor's middle, and then
    moved by what misalignment there is, about the same point.

    Args:
        superpixel: k.
        row: First modulator row seen by the sensor, nominally.
        column: First modulator column.
        mirrored: Whether the image of the modulator is mirrored left to right.
        quarter_turns: By how many quarters it is then turned clockwise.
        right_px: Shift of the image to the right, sensor pixels.
        down_px: Shift down.
        turn_mrad: Turn, right-hand side down.
        magnification: Of the image, against k modulator pixels per sensor pixel.
    """

    superpixel: int
    row: int
    column: int
    mirrored: bool = False
    quarter_turns: int = 0
    right_px: FiniteFloat = 0.0
    down_px: FiniteFloat = 0.0
    turn_mrad: Annotated[float, Field(ge=-TURN_LIMIT_MRAD, le=TURN_LIMIT_MRAD)] = 0.0
    magnification: Annotated[float, Field(gt=0, lt=10)] = 1.0

    @property
    def nominal(self) -> bool:
        """Get whether the sensor sees exactly the blocks that it should."""
        upright = not self.mirrored and self.quarter_turns % 4 == 0
        return upright and (self.right_px, self.down_px, self.turn_mrad, self.magnification) == (0, 0, 0, 1)

    def sensor_from_modulator(self, height: int, width: int) -> F64:
        """Return the affine map from modulator to sensor points, [2, 3]; x right, y down, pixel centres at +0.5."""
        k = self.superpixel
        onto_blocks = np.array([[1 / k, 0, -self.column / k], [0, 1 / k, -self.row / k], [0, 0, 1]])
        turn = np.pi / 2 * (self.quarter_turns % 4) + 1e-3 * self.turn_mrad
        about_middle = np.eye(3)
        about_middle[:2, :2] = self.magnification * np.array(
            [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        )
        about_middle[:2, :2] @= np.diag([-1.0 if self.mirrored else 1.0, 1.0])
        middle = np.array([0.5 * width, 0.5 * height])
        about_middle[:2, 2] = middle + np.array([self.right_px, self.down_px]) - about_middle[:2, :2] @ middle
        return np.asarray((about_middle @ onto_blocks)[:2])

    def on_sensor(self, interval: MaskInterval, height: int, width: int) -> F32:
        """Return a mask's transmissions at the sensor's pixels, [H, W] in [0, 1].

        Raises:
            InputError: The sensor looks beyond the modulator.
        """
        return self.seen(interval.levels, interval.top, height, width)

    def seen(self, levels: NDArray[Any], top: int, height: int, width: int) -> F32:
        """Return the mean transmission of modulator pixels [Hm, Wm] over each sensor pixel's square, [H, W].

        Raises:
            InputError: The sensor looks beyond the modulator, nominally. Where misalignment alone takes it there, it
                sees nothing.
        """
        k = self.superpixel
        block = levels[self.row : self.row + k * height, self.column : self.column + k * width]
        if block.shape != (k * height, k * width) or min(self.row, self.column) < 0:
            raise InputError(
                f"a sensor of {height} x {width} at {k} modulator pixels each, from row {self.row}, column "
                f"{self.column}, looks beyond the modulator's {list(levels.shape)}",
                remedy="change [registration]",
            )
        if self.nominal:
            means = block.reshape(height, k, width, k).mean(axis=(1, 3), dtype=np.float32)
            return np.asarray(means / np.float32(top), dtype=np.float32)
        return np.asarray(self._integrated(levels, height, width) / top, dtype=np.float32)

    def _integrated(self, levels: NDArray[Any], height: int, width: int) -> F64:
        """Integrate over squares by a summed-area table, which bilinear interpolation reads exactly."""
        affine = self.sensor_from_modulator(height, width)
        inverse = np.linalg.inv(affine[:, :2])
        y, x = np.mgrid[:height, :width] + 0.5
        points = np.stack([x - affine[0, 2], y - affine[1, 2]])
        u, v = np.tensordot(inverse, points, axes=1)
        side = float(np.sqrt(abs(np.linalg.det(inverse))))
        left, top = (max(int(np.floor(place.min() - side)), 0) for place in (u, v))
        right, bottom = int(np.ceil(u.max() + side)) + 1, int(np.ceil(v.max() + side)) + 1
        part = levels[top:bottom, left:right].astype(np.float64)
        table = np.zeros((part.shape[0] + 1, part.shape[1] + 1))
        table[1:, 1:] = part.cumsum(axis=0).cumsum(axis=1)

        def upto(column: F64, row: F64) -> F64:
            # Beyond the modulator nothing is added: the table goes on as at its rim.
            return np.asarray(map_coordinates(table, [row - top, column - left], order=1, mode="nearest"))

        half = 0.5 * side
        total = (
            upto(u + half, v + half) - upto(u - half, v + half) - upto(u + half, v - half) + upto(u - half, v - half)
        )
        return np.clip(total / side**2, 0.0, float(part.max(initial=0.0)))
