"""Standard errors of depths, pixel by pixel.

A depth errs as far as a turn in step with the travel may take the travel's place, the more the less relief was found;
by the error of a point's place in each view, the more the less the point moves through the views; and by how far along
its ray a pixel's light is stopped, since it may be that of the near thing or of the far one. Here: these together, on a
device where one works, and the error of places, which tracked points tell. Not here: that turn (`poses`), the factors
(`factors`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import relative_to
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.information import ReadingsSeen, middle_depth
from gs2ci.render.places import work_place

_WITHIN_ONE: Final = 0.68


def errors_of_depths(
    seen: ReadingsSeen, place_px: float, turn: float, others: F64 | None = None, stated: float = 0.0
) -> F32:
    """Return the standard error of each depth, [N, H, W], in its unit; 0 where there is no depth.

    If no stage or file gave the unit of lengths, it is that beyond the scale of the median depth, which no image
    determines.

    Args:
        seen: Depths and poses, and the views along them.
        place_px: Error of points' places through all views (`error_of_places`), px.
        turn: In step with the travel, that readings do not see (`unseen_turn`), or by which paths differ, rad.
        others: Given poses of further cameras that see the scene, [K, 4, 4].
        stated: A turn in step with a travel that is given, as the stage states it, rad: it takes no travel's place, so
            that it shifts all depths.
    """
    depth = seen.depth
    device = work_place()
    middle, found, missing = middle_depth(seen), np.zeros_like(depth), _missing_relief(depth[depth > 0])
    cameras = seen.world_to_camera if others is None else np.concatenate([seen.world_to_camera, others])
    per_rad = float(seen.focal_px.mean()) * len(cameras) ** 0.5
    sides = [(float(one.min()), float(one.max())) for one in np.moveaxis(seen.rays, -1, 0)]
    # View by view, since the float64 maps of all views of a large exposure may not fit into memory at once.
    for view in range(len(depth)):
        maps = depth[view], seen.spread[view], seen.rays
        own, spread, across = (torch.from_numpy(one).to(device).double() for one in maps)
        rays, known_there = across.unbind(dim=-1), own > 0
        ahead = torch.where(known_there, own, 1)
        points = (rays[0] * ahead, rays[1] * ahead, ahead)
        moved = movement(cameras, seen.focal_px, view, points, None if others is None else sides)
        # The travel that the turn stands for moves a point as its inverse depth says, the turn as the middle one's. The
        # more of a point's movement may be turn, the less the relief that was found is that of the scene.
        by_turn = (turn * per_rad / moved).clamp(max=1) * (middle / ahead - 1).square().add(missing**2).sqrt()
        by_stated = stated * per_rad / moved
        relative = ((place_px / moved) ** 2 + spread**2 + by_turn**2 + by_stated**2).sqrt()
        found[view] = torch.where(known_there, relative.clamp(max=1) * own, 0).float().cpu().numpy()
    return found


def _missing_relief(known: F32) -> float:
    """Return what the relief of depths, a spread of the logarithm, lacks of that which scenes may have.

    A fit begins flat, so that relief that readings leave open may not have been found.
    """
    low, high = np.log(np.quantile(known, (0.16, 0.84))) if known.size else (0.0, 0.0)
    return max(0.0, factors.unknown_depth - float(high - low))


def error_of_places(seen: ReadingsSeen, reference: int, followed: F64 | None) -> float:
    """Return the error of places, px, by how depths put tracked points beside where they were followed to in all views.

    Where a fit leaves the depth of small or faint things at that of their surroundings, readings hardly show it, and
    tracks do. What all depths have in common is no error of a place, but scale; what the light's spread along the ray
    puts beside is stated as such. Depths and tracks both err, and what two estimates differ by is √2 times the error of
    one.

    Args:
        seen: Depths and poses.
        reference: The view in which the tracks begin.
        followed: Slopes of tracked points in each view, [P, N, 2], NaN where one is not seen; None: there are none.

    Returns:
        The error by which, with the light's spread, 68 % of them are explained: of a place's movement as depth grows,
        the root of the sum of squares over the views, as `movement`. `factors.untracked_px` if no point tells.
    """
    if followed is None:
        return factors.untracked_px
    starts = followed[:, reference]
    _, at = cKDTree(seen.rays.reshape(-1, 2)).query(np.nan_to_num(starts))
    depth = seen.depth[reference].reshape(-1)[at].astype(np.float64)
    points = torch.from_numpy(np.stack([*(starts.T * depth), np.where(depth > 0, depth, np.nan)])).unbind()
    motions = relative_to(seen.world_to_camera, reference)
    found = torch.stack([torch.stack([*one, *two]) for one, two in (_moving(motion, points) for motion in motions)])
    places, steps = np.split(found.movedim(-1, 0).numpy(), 2, axis=2)
    told = np.isfinite(followed - places)
    share = told / np.maximum(told.sum(axis=1, keepdims=True), 1)
    off, steps = (np.where(told, one * seen.focal_px, 0) for one in (followed - places, steps))
    off, steps = (told * (one - (share * one).sum(axis=1, keepdims=True)) for one in (off, steps))
    moved = np.sqrt(np.square(steps).sum(axis=(1, 2)))
    tells = moved > 0
    if not tells.any():
        return factors.untracked_px
    spread, moved = seen.spread[reference].reshape(-1)[at][tells], moved[tells]
    beside = (off * steps).sum(axis=(1, 2))[tells] / moved
    common = beside @ moved / (moved @ moved)
    rest = (beside - common * moved) ** 2 - (spread * moved) ** 2
    return float(np.sqrt(np.quantile(rest.clip(min=0), _WITHIN_ONE) / 2))


def movement(
    world_to_camera: F64,
    focal_px: F64,
    view: int,
    points: Sequence[Tensor],
    sides: Sequence[tuple[float, float]] | None = None,
) -> Tensor:
    """Return how far points move through the views per relative change of their depth, px.

    Args:
        world_to_camera: [N, 4, 4].
        focal_px: Focal lengths, [2].
        view: The view along whose rays they move.
        points: Their three coordinates in the axes of this view, [...] each.
        sides: Least and largest x and y at z = 1 within a picture; a camera counts for the points within its picture.
            None: it counts for all before it.

    Returns:
        [...]: the root of the sum of squares, over the views, of the change of a point's place beyond the mean change;
        at least so much that no depth errs by more than itself.
    """
    squares, total = torch.zeros_like(points[0]), [torch.zeros_like(points[0]) for _ in focal_px]
    counted = torch.zeros_like(points[0])
    for motion in relative_to(world_to_camera, view):
        at, steps = _moving(motion, points)
        inside = at[0].isfinite()
        if sides is not None:
            for one, (low, high) in zip(at, sides, strict=True):
                inside = inside & (low <= one) & (one <= high)
        counted += inside
        for axis, focal in enumerate(focal_px.tolist()):
            place = torch.where(inside, steps[axis], 0) * focal
            total[axis] += place
            squares += place.square()
    spread = squares - sum(one.square() for one in total) / counted.clamp(min=1)
    return spread.clamp(min=0).sqrt().clamp(min=factors.place_px)


def _moving(motion: F64, points: Sequence[Tensor]) -> tuple[list[Tensor], list[Tensor]]:
    """Return where a camera, [4, 4], sees points, and how this moves as depth grows by a share: slopes, NaN behind."""
    x, y, z = points
    along = [right * x + down * y + ahead * z for right, down, ahead in motion[:3, :3].tolist()]
    depth = along[2] + float(motion[2, 3])
    ahead = torch.where(depth > 0, depth, torch.nan)
    at = [(along[axis] + float(motion[axis, 3])) / ahead for axis in (0, 1)]
    return at, [(along[axis] - at[axis] * along[2]) / ahead for axis in (0, 1)]
