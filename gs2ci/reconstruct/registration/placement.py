"""Where masks lie on the sensor, and what a sensor pixel then sees of them.

A mask element stated at x lies at x' = c + A (x − c) + t + f(x' − c), with the picture's middle c and a smooth field f
of second and third order, and fifth order radially, as a relay lens between modulator and sensor distorts its image. A
pixel integrates the light that falls on it. If elements are as wide as a pixel, or wider and aligned with the pixel
grid, a shifted mask seen by pixels is exactly the bilinear interpolation of its values, which is used here.

Here: the map and its sampling. Not here: its estimation (`coarse`, `fine`, `field`), blur and light (`misfit`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.run_figures import PlacementSection
from gs2ci.reconstruct.registration.kernels import sample
from gs2ci.reconstruct.registration.parameters import FIELD_AT_PX

# A pixel up to this far beyond the outermost centre still sees more of that element than of the unknown area.
_ON_THE_RIM_PX: Final = 0.5
# Displacements of the field change by hundredths from pixel to pixel: each round gains two digits.
_INVERSIONS: Final = 6


@dataclass(frozen=True)
class Placement(PlacementSection):
    """The position of masks relative to the stated one, and what follows from it."""

    @property
    def matrix(self) -> F64:
        """Get A, [2, 2], for positions as (row, column)."""
        turn = np.deg2rad(self.rotation_deg)
        lengthened = np.array(
            [[1 + self.scale - self.stretch, self.shear], [self.shear, 1 + self.scale + self.stretch]]
        )
        # Clockwise in a picture whose rows count downwards: from right (0, 1) towards down (1, 0).
        matrix: F64 = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ lengthened
        return matrix

    @property
    def shift_px(self) -> F64:
        """Get t, [2], as (down, right)."""
        return np.array([self.down_px, self.right_px])

    @property
    def is_identity(self) -> bool:
        """Get whether the masks lie at their stated position."""
        return self == Placement()

    @property
    def field(self) -> F64:
        """Get the coefficients of the field, [8], in the order of the arguments."""
        bent = (self.down_dd_px, self.down_dr_px, self.down_rr_px, self.right_dd_px, self.right_dr_px, self.right_rr_px)
        return np.array([self.radial_px, *bent, self.radial5_px])

    def with_field(self, field: F64) -> "Placement":
        """Return the same with other coefficients of the field, [8]."""
        radial, *bent = (float(one) for one in field)
        return Placement(*self._affine, radial, *bent)

    @property
    def _affine(self) -> tuple[float, float, float, float, float, float]:
        return (self.down_px, self.right_px, self.rotation_deg, self.scale, self.stretch, self.shear)

    def field_px(self, places: F64) -> F64:
        """Return the field's displacement at observed positions from the middle, both [..., 2] as (down, right)."""
        d, r = places[..., 0] / FIELD_AT_PX, places[..., 1] / FIELD_AT_PX
        squared = d * d + r * r
        outwards = (self.radial_px + self.radial5_px * squared) * squared
        down = outwards * d + self.down_dd_px * d * d + self.down_dr_px * d * r + self.down_rr_px * r * r
        right = outwards * r + self.right_dd_px * d * d + self.right_dr_px * d * r + self.right_rr_px * r * r
        return np.stack([down, right], axis=-1)

    def moved_px(self, places: F64) -> F64:
        """Return the displacement of elements stated at positions from the middle, both [K, 2] as (down, right)."""
        straight = places @ self.matrix.T + self.shift_px
        there = straight
        for _ in range(_INVERSIONS if self.field.any() else 0):
            there = straight + self.field_px(there)
        moved: F64 = there - places
        return moved

    def displacement_px(self, size: tuple[int, int]) -> F64:
        """Return the displacement of the masks at the picture's middle and four corners, [5, 2], as (down, right)."""
        middle = (np.array(size) - 1) / 2
        return self.moved_px(np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * middle)

    def sample(self, stack: F64, *, wrapped: bool = False) -> F64:
        """Return a stack of pictures in this position as pixels see it, [N, H, W].

        Beyond the border the nearest value is repeated, or the picture is continued periodically (wrapped).
        """
        inverse = np.linalg.inv(self.matrix)
        field = self.field / np.array([FIELD_AT_PX**3, *[FIELD_AT_PX**2] * 6, FIELD_AT_PX**5])
        return sample(stack, np.asarray(inverse, np.float64), self.shift_px, field, wrapped)

    @classmethod
    def from_affine(cls, matrix: F64, shift_px: F64) -> "Placement":
        """Make a placement from A, [2, 2], and t, [2]; the turn is chosen so that the rest of A is symmetric."""
        turn = np.arctan2(matrix[0, 1] - matrix[1, 0], matrix[0, 0] + matrix[1, 1])
        straight = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ matrix
        return cls(
            down_px=float(shift_px[0]),
            right_px=float(shift_px[1]),
            rotation_deg=float(np.rad2deg(turn)),
            scale=float(np.trace(straight) / 2 - 1),
            stretch=float((straight[1, 1] - straight[0, 0]) / 2),
            shear=float((straight[0, 1] + straight[1, 0]) / 2),
        )

    def known(self, size: tuple[int, int]) -> Bool:
        """Return the pixels that the displaced masks still cover, [H, W]."""
        row, column = np.meshgrid(np.arange(size[0]), np.arange(size[1]), indexing="ij")
        middle = (np.array(size) - 1) / 2
        here = np.stack([row, column], axis=-1) - middle
        places = (here - self.field_px(here) - self.shift_px) @ np.linalg.inv(self.matrix).T + middle
        inside: Bool = np.all((places >= -_ON_THE_RIM_PX) & (places <= np.array(size) - 1 + _ON_THE_RIM_PX), axis=-1)
        return inside
