"""The first Gaussians, on the points that the geometry stage found, and the order of Gaussians in memory.

Cells of neighbouring pixels are blended one after the other, and share most of their Gaussians: if these are adjacent
in memory, they are still in the cache. First Gaussians are made in this order, but a density rule appends new ones at
the end, so they are sorted again.

Here: sizes, opacities and orientations, how round Gaussians are made, and the order. Not here: their positions
(`geometry.points`), those beyond the borders of all views (`surfaces/margin.py`), the cells
(`gs2ci.render.cpu.layout`), when Gaussians are sorted (`coarse/state.py`).
"""

from typing import Final

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.points import Seeds
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians, logit

INITIAL_OPACITY: Final = 0.3
"""Three times that of Kerbl et al. 2023 (section 5.1), whose first points are sparse and uncertain: the points of a
plane sweep lie on one surface, and a short schedule has no time to make it opaque."""
_NEIGHBOURS: Final = 3  # as there: the mean distance to the three nearest
# First Gaussians as large as the distance would blur the decode, and each would be blended into twice as many pixels.
SIZE_PER_DISTANCE: Final = 0.7
# Duplicate points have distance 0, whose logarithm is infinite: no Gaussian starts smaller than this share of the
# grid's spacing.
_LEAST_SHARE_OF_SPACING: Final = 0.1


def first_gaussians(seeds: Seeds) -> Gaussians:
    """Put an isotropic, translucent Gaussian on every point, sized by the distance to its neighbours.

    Args:
        seeds: Points, [P, 3], with colours, [P, C], and spacing, [P]; a mono scene gets three equal channels.

    Returns:
        P Gaussians, float32.
    """
    sizes = SIZE_PER_DISTANCE * _neighbour_distance(seeds.positions)
    sizes = np.maximum(sizes, _LEAST_SHARE_OF_SPACING * seeds.spacing)
    return round_gaussians(seeds.positions, sizes, INITIAL_OPACITY, seeds.colours)


def round_gaussians(positions: F32 | F64, sizes: F32 | F64, opacity: float, colours: F32) -> Gaussians:
    """Make isotropic Gaussians that do not move, with one colour in all directions, float32.

    Args:
        positions: [P, 3].
        sizes: Standard deviations, [P].
        opacity: Of all.
        colours: [P, C]; one channel becomes three equal ones.
    """
    count = len(positions)
    return Gaussians(
        means=torch.from_numpy(positions.astype(np.float32)),
        log_scales=torch.from_numpy(np.log(sizes).astype(np.float32))[:, None].repeat(1, 3),
        quaternions=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        opacity_logits=logit(torch.full((count,), opacity)),
        colours=torch.from_numpy(np.broadcast_to(colours, (count, 3)).astype(np.float32)),
    )


def _neighbour_distance(positions: F32) -> F32:
    """Return the mean distance to the nearest others, [P]; zero if there are none."""
    neighbours = min(_NEIGHBOURS, len(positions) - 1)
    if neighbours < 1:
        return np.zeros(len(positions), np.float32)
    distances = np.asarray(cKDTree(positions).query(positions, k=neighbours + 1)[0])
    return distances[:, 1:].mean(axis=1).astype(np.float32)


# About the height in rows of a strip of cells if a quarter of the pixels is open.
_STRIP_PX: Final = 8


def raster_order(means: Tensor, world_to_camera: Tensor, intrinsics: Tensor) -> Tensor:
    """Return the indices of points in the order of a camera's picture, [G] int64: by strips, in each left to right.

    Args:
        means: [G, 3].
        world_to_camera: [4, 4].
        intrinsics: [3, 3], px.
    """
    points = means @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]
    places = (points / points[:, 2:].clamp(min=NEAR)) @ intrinsics.T
    across = torch.argsort(places[:, 0], stable=True)
    strips = torch.floor(places[across, 1] / _STRIP_PX)
    return across[torch.argsort(strips, stable=True)]
