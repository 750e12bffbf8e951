"""Corners of one exposure's pictures, followed into another's that a similarity warps onto them.

Features tie two exposures roughly; once one picture is warped onto the other by its depth, most corners are followed as
within an exposure, and how many are tells a right similarity from a wrong one: of pairs at 96 x 128 px 15 to 85 % along
right ones, 3 to 8 % along wrong ones.

Here: the corners and the matches that they become. Not here: where a similarity comes from (`pairs`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.reconstruct.exposures.pictures import MeanPicture, sampled
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.geometry.depth.view_depths import grid, project
from gs2ci.reconstruct.geometry.tracks.features import match_features
from gs2ci.reconstruct.geometry.tracks.tracks import TrackSettings, find_corners, refine_tracks

# So many corners of a picture, spread over it, are enough for its seven numbers; more take longer.
_CORNERS: Final = TrackSettings(corners=400)
# Corners are followed so far; the patches about them, of so many pixels to either side, are correlated so much.
_FOLLOWED_PX: Final = 5.0
_LEAST_LIKENESS: Final = 0.75
_PATCH_PX: Final = 5


@dataclass(frozen=True, eq=False)
class Matches:
    """Points that both of two exposures see.

    Args:
        one: In the coordinates of the first, by its depth, [M, 3].
        other: In those of the second, by its depth, [M, 3].
        at_one: Where the first sees them, [M, 2] px.
        at_other: Where the second does.
        pictures: Indices of the pictures of both, [M, 2].
        corners: Index of each among the corners of its picture in the second, [M]; -1 for features.
    """

    one: F64
    other: F64
    at_one: F64
    at_other: F64
    pictures: I64
    corners: I64

    def __len__(self) -> int:
        return len(self.one)

    @property
    def swapped(self) -> "Matches":
        """Get the same with first and second exchanged."""
        return Matches(self.other, self.one, self.at_other, self.at_one, self.pictures[:, ::-1], self.corners)

    def keep(self, chosen: Bool) -> "Matches":
        """Take the chosen ones only, [M]."""
        return Matches(*(part[chosen] for part in self._parts))

    @property
    def _parts(self) -> tuple[NDArray[Any], ...]:
        return self.one, self.other, self.at_one, self.at_other, self.pictures, self.corners

    @classmethod
    def joined(cls, parts: Sequence["Matches"]) -> "Matches":
        """Join matches of the same two exposures."""
        points, places = np.zeros((0, 3)), np.zeros((0, 2))
        none = cls(points, points, places, places, np.zeros((0, 2), np.int64), np.zeros(0, np.int64))
        return cls(
            *(np.concatenate(columns) for columns in zip(*(part._parts for part in (none, *parts)), strict=True))
        )

    @classmethod
    def lifted(
        cls, pictures: tuple[MeanPicture, MeanPicture], at: tuple[F64, F64], which: tuple[int, int], corners: I64
    ) -> "Matches":
        """Lift places, [M, 2] px, in two pictures, which have indices."""
        points = [picture.lifted(places) for picture, places in zip(pictures, at, strict=True)]
        return cls(points[0], points[1], *at, np.tile(np.array(which, np.int64), (len(corners), 1)), corners)


def matched(one: Sequence[MeanPicture], other: Sequence[MeanPicture]) -> Matches:
    """Match the features of all pictures of two exposures."""
    parts = []
    for i, first in enumerate(one):
        for j, second in enumerate(other):
            found = match_features(first.descriptors, second.descriptors).astype(np.int64)
            at = first.places[found[:, 0]].astype(np.float64), second.places[found[:, 1]].astype(np.float64)
            parts.append(Matches.lifted((first, second), at, (i, j), np.full(len(found), -1)))
    return Matches.joined(parts)


def followed(
    one: Sequence[MeanPicture], other: Sequence[MeanPicture], other_from_one: Similarity
) -> tuple[Matches, int]:
    """Follow the corners of the second's pictures into those of the first.

    Returns:
        The corners that were found, and the number of those that should be seen by both.
    """
    parts, visible = [], 0
    for j, second in enumerate(other):
        points = other_from_one.inverse.points(second.lifted(grid(second.inverse_depth.shape, 1)))
        corners = find_corners(second.image[None], 0, _CORNERS)
        for i, first in enumerate(one):
            places, _ = project(points, first.world_to_camera, first.intrinsics)
            places = places.reshape(*second.inverse_depth.shape, 2)
            warped, inside = sampled(first.image, places)
            stack = np.stack([second.image, np.where(inside[..., None], warped, second.image.mean())])
            numbers = np.flatnonzero(inside[corners[:, 1].astype(int), corners[:, 0].astype(int)])
            visible += len(numbers)
            kept, ends = _ends(stack, corners[numbers])
            at_first = _interpolated(places, ends)
            good = np.isfinite(at_first).all(axis=1)
            numbers = numbers[kept][good]
            parts.append(Matches.lifted((first, second), (at_first[good], corners[numbers]), (i, j), numbers))
    return Matches.joined(parts), visible


def _ends(stack: F32, corners: F64) -> tuple[Bool, F64]:
    """Follow corners, [P, 2] px, of the first picture of a stack into the second: which are found, and where."""
    if not len(corners):
        return np.zeros(0, bool), np.zeros((0, 2))
    ends = refine_tracks(stack, 0, np.repeat(corners[:, None], 2, axis=1)).positions[:, 1]
    kept = np.isfinite(ends).all(axis=1) & (np.linalg.norm(ends - corners, axis=1) < _FOLLOWED_PX)
    if kept.any():
        kept[kept] = _alike(stack, corners[kept], ends[kept])
    return kept, ends[kept]


def _interpolated(places: F64, pixels: F64) -> F64:
    """Interpolate a map of places, [H, W, 2], at pixels, [P, 2]; NaN where a neighbour lies behind the camera."""
    height, width = places.shape[:2]
    across = (pixels - 0.5).clip(0, (width - 1.001, height - 1.001))
    x, y = across.astype(int).T
    right, down = (across - across.astype(int)).T[:, :, None]
    above = (1 - right) * places[y, x] + right * places[y, x + 1]
    below = (1 - right) * places[y + 1, x] + right * places[y + 1, x + 1]
    return (1 - down) * above + down * below


def _alike(stack: F32, ones: F64, others: F64) -> Bool:
    """Tell about which places, [P, 2] px, of the two pictures of a stack patches are correlated."""
    steps = np.arange(-_PATCH_PX, _PATCH_PX + 1.0)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
    patches = []
    for picture, places in zip(stack, (ones, others), strict=True):
        values = sampled(picture, places[:, None] + offsets)[0].astype(np.float64)
        values -= values.mean(axis=1, keepdims=True)
        patches.append(values.reshape(len(places), -1))
    product = (patches[0] * patches[1]).sum(axis=1)
    size = np.linalg.norm(patches[0], axis=1) * np.linalg.norm(patches[1], axis=1)
    return product > _LEAST_LIKENESS * np.maximum(size, np.finfo(np.float64).tiny)
