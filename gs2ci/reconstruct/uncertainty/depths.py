"""Standard errors of depths, pixel by pixel.

A depth errs with the path, by which all depths shift together; as far as a turn in step with the travel may take the
travel's place; by the error of a point's place in each view, the more the less the point moves through the views; by
the thickness of the light that it is the median of; and where near and far meet, because an edge may lie a pixel off.
Here: these together, on a device where one works. Not here: that turn (`poses`), the factors (`factors`).
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.information import ReadingsSeen, turned
from gs2ci.reconstruct.uncertainty.slopes import slopes
from gs2ci.render.places import work_place


def errors_of_depths(seen: ReadingsSeen, spread: F32, path_error: float, turn: float, others: F64 | None = None) -> F32:
    """Return the standard error of each depth, [N, H, W], in its unit; 0 where there is no depth.

    If no stage or file gave the unit of lengths, it is that beyond the scale of the median depth, which no image
    determines.

    Args:
        seen: Depths and poses, and the views along them.
        spread: Of the light along the ray, as a share of depth, [N, H, W].
        path_error: Expected error of the path, as a share of its extent.
        turn: In step with the travel, that readings do not see (`unseen_turn`), rad.
        others: Given poses of further cameras that see the scene, [K, 4, 4].
    """
    depth = seen.depth
    there = depth > 0
    if not there.any():
        return np.zeros_like(depth)
    device, most = work_place(), factors.most_of_jump
    middle, found = float(np.median(depth[there])), np.zeros_like(depth)
    cameras = seen.world_to_camera if others is None else np.concatenate([seen.world_to_camera, others])
    moved_by_turn = turn * float(seen.focal_px.mean()) * len(cameras) ** 0.5
    sides = [(float(one.min()), float(one.max())) for one in np.moveaxis(seen.rays, -1, 0)]
    # View by view, since the float64 maps of all views of a large exposure may not fit into memory at once.
    for view in range(len(depth)):
        own, across, light = (torch.from_numpy(one).to(device) for one in (depth[view], seen.rays, spread[view]))
        own, rays, known_there = own.double(), across.double().unbind(dim=-1), own > 0
        ahead = torch.where(known_there, own, 1)
        points = (rays[0] * ahead, rays[1] * ahead, ahead)
        moved = movement(cameras, seen.focal_px, view, points, None if others is None else sides)
        jump = torch.hypot(*slopes(torch.where(known_there, own, torch.nan).log())).nan_to_num(nan=most).clamp(max=most)
        by_path = factors.depth_by_path * path_error * (factors.at_middle + (own / middle - 1).abs())
        # The travel that the turn stands for moves a point as its inverse depth says, the turn as the middle one's. The
        # more of a point's movement may be turn, the less its depth tells how far from the middle it lies.
        share = (moved_by_turn / moved).clamp(max=1)
        by_turn = share * torch.hypot(middle / ahead - 1, share * factors.unknown_depth)
        by_light = torch.hypot(factors.depth_by_spread * light.double(), factors.depth_by_jump * jump)
        relative = ((factors.place_px / moved) ** 2 + by_light**2 + by_path**2 + by_turn**2).sqrt()
        found[view] = torch.where(known_there, relative.clamp(max=1) * own, 0).float().cpu().numpy()
    return found


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
            None: every camera counts for all.

    Returns:
        [...]: the root of the sum of squares, over the views, of the change of a point's place beyond the mean change;
        at least so much that no depth errs by more than itself.
    """
    squares, total = torch.zeros_like(points[0]), [torch.zeros_like(points[0]) for _ in focal_px]
    counted = torch.zeros_like(points[0])
    for motion in world_to_camera @ np.linalg.inv(world_to_camera[view]):
        # How a point moves in each camera's axes as its depth grows by a share, and where it is.
        along = turned(motion, points)
        depth = along[2] + float(motion[2, 3])
        ahead = torch.where(depth > 0, depth, torch.inf)
        at = [(along[axis] + float(motion[axis, 3])) / ahead for axis in (0, 1)]
        if sides is not None:
            inside = [(low <= one) & (one <= high) for one, (low, high) in zip(at, sides, strict=True)]
            ahead = torch.where(inside[0] & inside[1], ahead, torch.inf)
        counted += ahead.isfinite() if sides is not None else 1
        for axis, focal in enumerate(focal_px.tolist()):
            place = (along[axis] - at[axis] * along[2]) / ahead * focal
            total[axis] += place
            squares += place.square()
    spread = squares - sum(one.square() for one in total) / counted.clamp(min=1)
    return spread.clamp(min=0).sqrt().clamp(min=factors.place_px)
