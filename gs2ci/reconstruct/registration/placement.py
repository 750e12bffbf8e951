"""Where masks lie on the sensor, and what a sensor pixel then sees of them.

A mask element stated at x lies at x' = c + A (x − c) + t + f(x' − c), with the picture's middle c and a smooth field f
of second and third order, and fifth order radially, as a relay lens between modulator and sensor distorts its image. A
pixel integrates the light that falls on it. If elements are as wide as a pixel, or wider and aligned with the pixel
grid, a shifted mask seen by pixels is exactly the bilinear interpolation of its values, which is used here.

Here: the map and its sampling. Not here: its estimation (`coarse`, `fine`, `proposals`), blur and light (`misfit`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F64, Bool, Size
from gs2ci.core.run_figures import PlacementSection
from gs2ci.reconstruct.registration.parameters import FIELD, FIELD_AT_PX, GEOMETRY

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
        return np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ lengthened

    @property
    def shift_px(self) -> F64:
        """Get t, [2], as (down, right)."""
        return np.array([self.down_px, self.right_px])

    @property
    def is_identity(self) -> bool:
        """Get whether the masks lie at their stated position."""
        return not any(getattr(self, name) for name in GEOMETRY)

    @property
    def field(self) -> F64:
        """Get the coefficients of the field, [8], in the order of the arguments."""
        return np.array([getattr(self, name) for name in FIELD])

    def changed(self, name: str, by: float) -> Self:
        """Return the same with one parameter changed."""
        return replace(self, **{name: getattr(self, name) + by})

    def moved(self, down_px: float, right_px: float) -> Self:
        """Return the same shifted further."""
        return self.changed("down_px", down_px).changed("right_px", right_px)

    def field_px(self, places: F64) -> F64:
        """Return the field's displacement at observed positions from the middle, both [..., 2] as (down, right)."""
        radial, *bent, fifth = self.field
        if not self.field.any():
            return np.zeros_like(places)
        at = places / FIELD_AT_PX
        d, r = at[..., 0], at[..., 1]
        squared = d * d + r * r
        outwards = (radial + fifth * squared) * squared
        return outwards[..., None] * at + np.stack([d * d, d * r, r * r], axis=-1) @ np.reshape(bent, (2, 3)).T

    def stated_at(self, places: F64) -> F64:
        """Return where elements are stated that are seen at positions from the middle, both [..., 2]."""
        return (places - self.field_px(places) - self.shift_px) @ np.linalg.inv(self.matrix).T

    def derivatives(self, steps: Mapping[str, float], places: F64) -> F64:
        """Return how far steps of parameters move what is seen at positions from the middle, [..., 2]; [P, ..., 2]."""
        stated, bent = self.stated_at(places), self.field_px(places)
        straight = stated @ self.matrix.T + self.shift_px

        def seen(name: str, by: float) -> F64:
            one = self.changed(name, by)
            if name in FIELD:
                return straight + one.field_px(places)
            return stated @ one.matrix.T + one.shift_px + bent

        moved = [(seen(name, step) - seen(name, -step)) / 2 for name, step in steps.items()]
        return np.reshape(moved, (len(steps), *places.shape))

    def moved_px(self, places: F64) -> F64:
        """Return the displacement of elements stated at positions from the middle, both [K, 2] as (down, right)."""
        straight = places @ self.matrix.T + self.shift_px
        there = straight
        for _ in range(_INVERSIONS if self.field.any() else 0):
            there = straight + self.field_px(there)
        return there - places

    def displacement_px(self, size: Size) -> F64:
        """Return the displacement of the masks at the picture's middle and four corners, [5, 2], as (down, right)."""
        middle = (np.array(size) - 1) / 2
        return self.moved_px(np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * middle)

    def sample(self, stack: F64, *, wrapped: bool = False) -> F64:
        """Return a stack of pictures in this position as pixels see it, [N, H, W].

        Beyond the border the nearest value is repeated, or the picture is continued periodically (wrapped).
        """
        size = stack.shape[1:]
        at = np.moveaxis(self.stated_at(from_middle(size)) + (np.array(size) - 1) / 2, -1, 0)
        pictures = stack.astype(np.float64)
        return np.stack(
            [map_coordinates(one, at, order=1, mode="grid-wrap" if wrapped else "nearest") for one in pictures]
        )

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

    def known(self, size: tuple[int, ...], beyond_px: float = 0.5) -> Bool:
        """Return the pixels that the displaced masks still cover, [H, W], so far beyond the outermost centres."""
        # Up to half a pixel beyond the outermost centre a pixel sees more of that element than of the unknown area.
        most = (np.array(size) - 1) / 2 + beyond_px
        return np.all(np.abs(self.stated_at(from_middle(size))) <= most, axis=-1)


def from_middle(size: tuple[int, ...]) -> F64:
    """Return the positions of all pixels from the picture's middle, [H, W, 2] as (down, right)."""
    return np.stack(np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in size), indexing="ij"), axis=-1)
