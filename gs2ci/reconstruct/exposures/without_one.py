"""What leaving one of several exposures out would change, from what all of them together tell; nothing is fitted again.

A surface point is seen by views of several exposures. Each reads its colour with an information w_n, the mean square
of its mask's light over the power of what its exposure's readings err by; and, if the point's depth along a ray
changed by a share λ, the point would move in the picture of view n by λ v_n. What the point looks like is not known
either, so a motion that all views have in common tells nothing:

    colour: Σ w_n        depth: Σ w_n |v_n - v̄|²,   v̄ = Σ w_n v_n / Σ w_n

Both are sums over views, so that those of one exposure are taken away at once. Texture is the same for all and drops
out. Poses count as known: errors that all depths of an exposure share are not in it.

Here: these figures. Not here: absolute standard errors (`reconstruct.uncertainty`), which exposures there are.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, I64, Bool
from gs2ci.core.cameras import camera_centres, in_camera
from gs2ci.core.lens import places_of, rays_of
from gs2ci.core.run_figures import WithoutExposure

# Points of each exposure's middle view, on a lattice.
_POINTS: Final = 800
# A view sees a point if its own depth there differs by no more than this share.
_SAME_SURFACE: Final = 0.05


@dataclass(frozen=True, eq=False)
class ViewsTogether:
    """The views of several exposures in common coordinates.

    Args:
        depth: Along the optical axis, [V, H, W]; 0 where there is none.
        world_to_camera: [V, 4, 4].
        intrinsics: [3, 3], px.
        distortion: Of the lens, [5]; None for a pinhole.
        information: Of each view about a colour, [V]: mean square of its mask's light, over the power of errors.
        exposure: Which exposure each view is of, [V], in order.
    """

    depth: F32
    world_to_camera: F64
    intrinsics: F64
    distortion: F64 | None
    information: F64
    exposure: I64

    def rays(self, pixels: F64) -> F64:
        """Return the rays of pixels, [P, 2] as (x, y), at z = 1: [P, 3]."""
        return rays_of(pixels, self.intrinsics, self.distortion)

    def sees(self, view: int, points: F64) -> Bool:
        """Tell which points, [P, 3], a view shows: those in its picture that lie on its own surface, [P]."""
        height, width = self.depth.shape[1:]
        pose = self.world_to_camera[view]
        there = in_camera(points, pose)
        ahead = there[:, 2] > 0
        slopes = there[:, :2] / np.where(ahead, there[:, 2], 1.0)[:, None]
        pixels = places_of(slopes, self.intrinsics, self.distortion)
        inside = ahead & (pixels >= 0).all(axis=1) & (pixels < (width, height)).all(axis=1)
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.int64).T
        return inside & (np.abs(self.depth[view, row, column] - there[:, 2]) <= _SAME_SURFACE * there[:, 2])


@dataclass(frozen=True, eq=False)
class _Told:
    """Sums over views about points: of w, [P], w v, [P, 3], and w |v|², [P]."""

    weight: F64
    first: F64
    second: F64

    def less(self, other: "_Told", kept: Bool) -> "_Told":
        """Return the sums without those of some views, at points where others are left, [P]; elsewhere nothing."""
        return _Told(
            np.where(kept, self.weight - other.weight, 0.0),
            np.where(kept[:, None], self.first - other.first, 0.0),
            np.where(kept, self.second - other.second, 0.0),
        )

    def depth(self) -> F64:
        """Return the information about depths, [P]."""
        mean_square = np.square(self.first).sum(axis=1) / np.where(self.weight > 0, self.weight, 1.0)
        return np.maximum(self.second - mean_square, 0.0)


def without_each(views: ViewsTogether) -> tuple[WithoutExposure, ...]:
    """Return what leaving out each exposure in its turn would change."""
    count = int(views.exposure.max()) + 1
    points, rays, owner = _points(views, count)
    own = [_told(views, number, points, rays) for number in range(count)]
    weight, first = np.sum([one.weight for one in own], axis=0), np.sum([one.first for one in own], axis=0)
    whole, found = _Told(weight, first, np.sum([one.second for one in own], axis=0)), []
    for number, one in enumerate(own):
        others = np.any([other.weight > 0 for k, other in enumerate(own) if k != number], axis=0)
        rest, mine, both = whole.less(one, others), owner == number, (one.weight > 0) & others
        alone = float((~others)[mine].mean()) if mine.any() else 0.0
        found.append(
            WithoutExposure(alone, _times(whole.depth(), rest.depth(), both), _times(weight, rest.weight, both))
        )
    return tuple(found)


def _times(whole: F64, rest: F64, chosen: Bool) -> float | None:
    """Return the median ratio of standard errors at points, given the information with and without an exposure."""
    known = chosen & (whole > 0)
    if not known.any():
        return None
    share = float(np.median(rest[known] / whole[known]))
    return share**-0.5 if share > 0 else None


def _points(views: ViewsTogether, count: int) -> tuple[F64, F64, I64]:
    """Return points that the exposures' middle views show, the vectors from their cameras, and which exposure's."""
    height, width = views.depth.shape[1:]
    step = max(1, int(np.ceil(np.sqrt(height * width / _POINTS))))
    rows, columns = (one.ravel() for one in np.mgrid[step // 2 : height : step, step // 2 : width : step])
    rays = views.rays(np.stack([columns, rows], axis=1) + 0.5)
    points, seen_from, owner = [], [], []
    for number in range(count):
        members = np.flatnonzero(views.exposure == number)
        middle = int(members[len(members) // 2])
        depth, pose = views.depth[middle, rows, columns].astype(np.float64), views.world_to_camera[middle]
        known = depth > 0
        turned = (rays[known] * depth[known, None]) @ pose[:3, :3]
        points.append(turned - pose[:3, 3] @ pose[:3, :3])
        seen_from.append(turned)
        owner.append(np.full(int(known.sum()), number))
    return np.concatenate(points), np.concatenate(seen_from), np.concatenate(owner)


def _told(views: ViewsTogether, number: int, points: F64, rays: F64) -> _Told:
    """Return what the views of one exposure tell about all points."""
    weight, first, second = np.zeros(len(points)), np.zeros((len(points), 3)), np.zeros(len(points))
    for view in np.flatnonzero(views.exposure == number):
        light = np.where(views.sees(int(view), points), views.information[view], 0.0)
        line = points - camera_centres(views.world_to_camera[view : view + 1])[0]
        away = np.linalg.norm(line, axis=1, keepdims=True)
        towards = line / away
        moves = (rays - towards * (towards * rays).sum(axis=1, keepdims=True)) / away
        weight += light
        first += light[:, None] * moves
        second += light * np.square(moves).sum(axis=1)
    return _Told(weight, first, second)
