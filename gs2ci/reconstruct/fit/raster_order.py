"""The order in which Gaussians lie in memory: that in which a picture is rendered.

Cells of neighbouring pixels are blended one after the other, and share most of their Gaussians: where these lie beside
each other, they are still in the cache. First Gaussians are made in this order, and every turn of a density rule puts
its newcomers at the end. Here: the order. Not here: the cells (`gs2ci.render.cpu.layout`), turns (`coarse.py`).
"""

from typing import Final

import torch
from torch import Tensor

from gs2ci.render.conventions import NEAR

# About as many rows as a strip of cells has where a quarter of the pixels is open.
_STRIP_PX: Final = 8


def raster_order(means: Tensor, world_to_camera: Tensor, intrinsics: Tensor) -> Tensor:
    """Return the indices of points as one camera sees them, strip by strip, in each from left to right; [G] int64.

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
