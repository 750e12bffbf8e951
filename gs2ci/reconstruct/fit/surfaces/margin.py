"""Gaussians beyond the borders of all views, so that the scene does not end where the recorded pictures end.

No reading tells what lies there, and the opacity term removes the Gaussians of which no pixel tells anything. The scene
then ends in a ragged border, and a view from one step beyond the path is black along one side. So surfaces and colours
at the borders are continued outwards, as far as such a step shifts the picture. That is a guess, as anything there is,
black included. No recorded pixel needs it; the fit goes on behind it, so that the borders of the views stay right.

Here: where these Gaussians lie and what they look like. Not here: when they are added, and that later steps pass over
them (`coarse/state.py`, `paper/fine.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from pydantic import PositiveInt
from scipy.ndimage import distance_transform_edt

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.core.bounds import Bounded
from gs2ci.core.cameras import in_camera, in_world
from gs2ci.core.config import Positive
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import SIZE_PER_DISTANCE, round_gaussians
from gs2ci.reconstruct.geometry.path.motion import rays
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians

_OPACITY: Final = 0.95  # with this and `SIZE_PER_DISTANCE` no light passes between neighbours
# So much farther away than the surface that they continue: where they reach into the recorded pictures, they lie behind
# it. A larger share would show as parallax.
_BEHIND: Final = 0.02
# Of the shifts at the borders: single wrong depths must not widen the margin.
_SHIFT_QUANTILE: Final = 0.95


@dataclass(frozen=True)
class MarginSettings(Bounded):
    """How a scene is continued beyond the borders of all views.

    Args:
        stride: Distance of neighbouring Gaussians, px.
        most: Largest width of the margin as a share of the picture's larger side.
    """

    stride: PositiveInt = 2
    most: Positive = 1 / 32


@dataclass(frozen=True)
class MarginSource:
    """What some views of a scene show.

    Args:
        numbers: Which of the N views, [K].
        views: Those of them at least, by number, [H, W, C] float32 each.
        inverse_depth: Of the surfaces in the K views, on the sensor, [K, H, W]; 0 where none is known.
    """

    numbers: tuple[int, ...]
    views: Mapping[int, F32]
    inverse_depth: F32


def margin(
    renderer: ShotRenderer, scene: Gaussians, world_to_camera: F64, source: MarginSource, settings: MarginSettings
) -> Gaussians | None:
    """Continue a scene beyond the borders of all views; None if its borders show no surface.

    Args:
        renderer: Of the shot, with its lens.
        scene: The Gaussians.
        world_to_camera: Poses of all views, [N, 4, 4].
        source: Colours and depths to continue.
        settings: How far, how densely.
    """
    frame = _Frame.of(renderer)
    inverse_depth = frame.at_border(source.inverse_depth)
    width = _width(frame, inverse_depth, world_to_camera, source.numbers, settings)
    # Nearer than one stride to the border of any view they show in it, through what the fit left open there.
    clear = settings.stride
    outside = frame.outside(clear, clear + width, settings.stride)
    parts: list[tuple[F64, F64, F32]] = []
    taken: list[int] = []
    last = len(source.numbers) - 1
    # From the ends of the path to its middle: the ends see farthest to their sides.
    for k in sorted(range(last + 1), key=lambda k: min(k, last - k)):
        number = source.numbers[k]
        ahead = inverse_depth[k][outside.nearest].astype(np.float64)
        known = ahead > 0
        depth = (1 + _BEHIND) / np.where(known, ahead, 1.0)
        points = in_world(outside.rays * depth[:, None], world_to_camera[number])
        shown = frame.sees(points, world_to_camera, outside.near)
        new = known & ~shown & ~frame.sees(points, world_to_camera[taken], outside.within)
        taken.append(number)
        colours = frame.at_border(source.views[number][None])[0][outside.nearest]
        parts.append((points[new], depth[new], colours[new]))
    positions, depth, colours = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(positions):
        return None
    sizes = SIZE_PER_DISTANCE * settings.stride * depth / frame.focal_px
    found = round_gaussians(positions, sizes, _OPACITY, colours)
    # They do not move, and have one colour in all directions.
    further = {name: one for name, one in scene.parameters().items() if getattr(found, name) is None}
    return replace(found, **{name: one.new_zeros((len(found), *one.shape[1:])) for name, one in further.items()})


@dataclass(frozen=True)
class _Outside:
    """Places around the picture.

    Args:
        rays: At z = 1 in camera coordinates, [P, 3].
        nearest: Of each the nearest place of the border, an index into `_Frame.border`, [P].
        near: The pixels of a picture widened by w all around that are seen or too near to those, [Hc + 2 w, Wc + 2 w].
        within: These and all around them as far as the places lie, likewise.
    """

    rays: F64
    nearest: I64
    near: Bool
    within: Bool


@dataclass(frozen=True)
class _Frame:
    """What of a pinhole's picture the sensor sees.

    Args:
        intrinsics: [3, 3], px.
        seen: Whether the sensor sees a pixel of that picture, [Hc, Wc].
        border: The seen pixels that have a neighbour that is not seen, row and column, [B, 2].
        on_sensor: Row and column of each on the sensor, [B, 2].
    """

    intrinsics: F64
    seen: Bool
    border: I64
    on_sensor: I64

    @classmethod
    def of(cls, renderer: ShotRenderer) -> "_Frame":
        lens = renderer.lens
        height, width = renderer.size
        seen = np.ones((height, width), bool) if lens is None else lens.seen
        inner = distance_transform_edt(np.pad(seen, 1))[1:-1, 1:-1]
        border = np.argwhere(seen & (inner <= 1))
        if lens is None:
            return cls(renderer.intrinsics.double().numpy(), seen, border, border)
        at = np.floor(lens.seen_at[border[:, 0], border[:, 1]][:, ::-1]).astype(np.int64)
        return cls(lens.canvas_intrinsics, seen, border, at.clip(0, (height - 1, width - 1)))

    @property
    def focal_px(self) -> float:
        return float(np.sqrt(self.intrinsics[0, 0] * self.intrinsics[1, 1]))

    def at_border(self, pictures: F32) -> F32:
        """Pick the border's pixels of pictures on the sensor, [K, H, W, ...]: [K, B, ...]."""
        return pictures[:, self.on_sensor[:, 0], self.on_sensor[:, 1]]

    def rays(self, places: I64) -> F64:
        """Return the rays of pixels, given as row and column, [P, 2]: [P, 3]."""
        return rays(places[:, ::-1].astype(np.float64) + 0.5, self.intrinsics)

    def outside(self, clear: int, width: int, stride: int) -> _Outside:
        """List every `stride`-th place, along rows and columns, from beyond `clear` to `width` pixels outside."""
        distance, at = distance_transform_edt(~np.pad(self.seen, width), return_indices=True)
        places = np.argwhere((distance > clear) & (distance <= width))
        places = places[(places % stride == 0).all(axis=1)]
        nearest = at[:, places[:, 0], places[:, 1]].T - width
        numbers = np.zeros(self.seen.shape, np.int64)
        numbers[self.border[:, 0], self.border[:, 1]] = np.arange(len(self.border))
        at_border = numbers[nearest[:, 0], nearest[:, 1]]
        return _Outside(self.rays(places - width), at_border, distance <= clear, distance <= width)

    def sees(self, points: F64, world_to_camera: F64, picture: Bool) -> Bool:
        """Tell which points, [P, 3], some pose sees, by the pixels of the picture or of one widened all around."""
        width, limits = (len(picture) - len(self.seen)) // 2, np.array(picture.shape)
        found = np.zeros(len(points), bool)
        for pose in world_to_camera:
            place, ahead = self.project(points, pose)
            at = np.floor(np.where(ahead[:, None], place, -1.0) + width)[:, ::-1]
            inside = ahead & ((at >= 0) & (at < limits)).all(axis=1)
            row, column = at[inside].astype(np.int64).T
            found[inside] |= picture[row, column]
        return found

    def project(self, points: F64, pose: F64) -> tuple[F64, Bool]:
        """Project points, [P, 3], to x and y, [P, 2], px; also tell which lie before the camera."""
        there = in_camera(points, pose)
        ahead = there[:, 2] > NEAR
        slopes = there[:, :2] / np.where(ahead, there[:, 2], 1.0)[:, None]
        return slopes @ self.intrinsics[:2, :2].T + self.intrinsics[:2, 2], ahead


def _width(
    frame: _Frame, inverse_depth: F32, world_to_camera: F64, numbers: tuple[int, ...], settings: MarginSettings
) -> int:
    """Return how far a step along the path shifts the picture at its border, px, within the settings' bound."""
    rays, at = frame.rays(frame.border), frame.border[:, ::-1] + 0.5
    shifts = [np.zeros(1)]
    for ahead, view in zip(inverse_depth, numbers, strict=True):
        known = ahead > 0
        points = in_world(rays[known] / ahead[known, None], world_to_camera[view])
        for other in {max(view - 1, 0), min(view + 1, len(world_to_camera) - 1)} - {view}:
            place, there = frame.project(points, world_to_camera[other])
            shifts.append(np.linalg.norm(place - at[known], axis=1)[there])
    most = max(1, int(settings.most * max(frame.seen.shape)))
    step = float(np.quantile(np.concatenate(shifts), _SHIFT_QUANTILE))
    # One more: Gaussians at the outer end fade within the margin.
    return min(most, round(step) + 1)
