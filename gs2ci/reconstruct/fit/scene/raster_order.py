"""The order of Gaussians in memory: that in which a picture is rendered.

Cells of neighbouring pixels are blended one after the other, and share most of their Gaussians: if these are adjacent
in memory, they are still in the cache. First Gaussians are made in this order, but a density rule appends new ones at
the end, so they are sorted again. Here: the order. Not here: the cells (`gs2ci.render.cpu.layout`), when they are
sorted (`coarse/state.py`).
"""

from typing import Final

import torch
from torch import Tensor

from gs2ci.render.conventions import NEAR

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
