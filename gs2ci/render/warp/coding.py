"""The open pixels of a mask set, sorted by view and tile and cut into blocks: made once for each mask set."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from torch import Tensor

from gs2ci.render.conventions import FRUSTUM_MARGIN
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.warp.types import BLOCK, TiledCamera

# A tile is chosen so large that its open pixels fill so much of a block in the mean: fuller ones are cut in two.
_FILL: Final = 0.75
# Tiles of masks that are almost closed would become as large as the picture.
_LEAST_OPEN: Final = 1e-3


@dataclass(frozen=True, eq=False)
class OpenBlocks:
    """The open pixels ("slots") of V views.

    Args:
        views: V.
        size: Height and width of the picture, px.
        frame: Height and width of the canvas that Gaussians are projected to, px.
        tile: Height and width of a tile, px.
        device: Where the arrays lie.
        x: Where each slot looks on the canvas, [S].
        y: Likewise.
        into: The element of the output that each slot adds to, [S]: its pixel, or its view's pixel.
        weight: Mask value times weight of each slot, [S].
        block_of: The block of each slot, [S].
        first: The first slot of each block, and S, [blocks + 1].
        blocks_before: Number of blocks before each tile of each view, and their total, [V * tiles + 1].
        start: Where the slots of each output element begin in `slots`, [elements + 1].
        slots: The slots of each output element, in the order of views, [S].
        blocks: Number of blocks.
        outputs: Number of output elements.
    """

    views: int
    size: tuple[int, int]
    frame: tuple[int, int]
    tile: tuple[int, int]
    device: str
    x: Any
    y: Any
    into: Any
    weight: Any
    block_of: Any
    first: Any
    blocks_before: Any
    start: Any
    slots: Any
    blocks: int
    outputs: int

    def camera(self, intrinsics: NDArray[np.float64]) -> TiledCamera:
        """Return a pinhole of this camera matrix, [3, 3] in pixels of the canvas, with the canvas's tiles."""
        camera = TiledCamera()
        (height, width), (tile_h, tile_w) = self.frame, self.tile
        fx, fy, cx, cy = (float(intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        margin_u, margin_v = FRUSTUM_MARGIN * width / fx, FRUSTUM_MARGIN * height / fy
        camera.fx, camera.fy, camera.cx, camera.cy = fx, fy, cx, cy
        camera.width, camera.height = float(width), float(height)
        camera.u_low, camera.u_high = -cx / fx - margin_u, (width - cx) / fx + margin_u
        camera.v_low, camera.v_high = -cy / fy - margin_v, (height - cy) / fy + margin_v
        camera.tile_h, camera.tile_w = tile_h, tile_w
        camera.tiles_x, camera.tiles_y = -(-width // tile_w), -(-height // tile_h)
        return camera


def code(masks: Tensor, device: str, sampling: CanvasSampling | None = None, *, apart: bool = False) -> OpenBlocks:
    """Compact the open pixels of masks, [V, H, W] float32, where they lie; what is counted by tile is the host's.

    Args:
        masks: Mask value times weight; pixels at 0 are left out. On the device, if torch can hold tensors there.
        device: A name of Warp's.
        sampling: Where the pixels look, behind a lens.
        apart: Every view has an output of its own, instead of one coded sum.
    """
    views, height, width = masks.shape
    frame = (height, width) if sampling is None else sampling.canvas
    flat = masks.reshape(views, height * width)
    view, pixel = (flat > 0).nonzero(as_tuple=True)
    tile_h, tile_w = _tile(len(pixel) / masks.numel() if masks.numel() else 1.0)
    tiles_x, tiles_y = -(-frame[1] // tile_w), -(-frame[0] // tile_h)
    if sampling is None:
        numbers = torch.arange(height * width, device=masks.device)
        x, y = (numbers % width).double() + 0.5, (numbers // width).double() + 0.5
    else:
        x, y = torch.from_numpy(sampling.places.reshape(-1, 2)).to(masks.device).unbind(dim=1)
    tile = (y.long() // tile_h) * tiles_x + x.long() // tile_w
    key, order = (view * (tiles_x * tiles_y) + tile[pixel]).sort(stable=True)
    view, pixel = view[order], pixel[order]
    begins = _begins(key, views * tiles_x * tiles_y).cpu().numpy()
    per_tile = np.diff(begins)
    blocks_of = -(-per_tile // BLOCK)
    blocks_before = np.concatenate([[0], np.cumsum(blocks_of)])
    blocks = int(blocks_before[-1])
    owner = np.repeat(np.arange(len(per_tile)), blocks_of)
    within = np.arange(blocks) - blocks_before[owner]
    # A tile's pixels are dealt evenly among its blocks.
    first = np.append(begins[owner] + within * per_tile[owner] // blocks_of[owner], len(pixel))
    block_of = torch.from_numpy(first[1:]).to(masks.device)
    block_of = torch.searchsorted(block_of, torch.arange(len(pixel), device=masks.device), right=True)
    into = view * (height * width) + pixel if apart else pixel
    outputs = height * width * (views if apart else 1)
    # Equal ones stay in the order of views.
    written, slots = into.sort(stable=True)

    def of(values: Tensor, kind: Any) -> Any:
        made = values.to(masks.device, torch.int32 if kind is wp.int32 else torch.float32).contiguous()
        shared = made.is_cuda or device == "cpu"
        return wp.from_torch(made) if shared else wp.array(made.numpy(), dtype=kind, device=device)

    return OpenBlocks(
        views=views,
        size=(height, width),
        frame=frame,
        tile=(tile_h, tile_w),
        device=device,
        x=of(x[pixel], wp.float32),
        y=of(y[pixel], wp.float32),
        into=of(into, wp.int32),
        weight=of(flat[view, pixel], wp.float32),
        block_of=of(block_of, wp.int32),
        first=of(torch.from_numpy(first), wp.int32),
        blocks_before=of(torch.from_numpy(blocks_before), wp.int32),
        start=of(_begins(written, outputs), wp.int32),
        slots=of(slots, wp.int32),
        blocks=blocks,
        outputs=outputs,
    )


def _begins(ordered: Tensor, count: int) -> Tensor:
    """Return where each of so many numbers begins among ordered ones, and where the last ends, [count + 1]."""
    return torch.searchsorted(ordered, torch.arange(count + 1, device=ordered.device))


def _tile(open_share: float) -> tuple[int, int]:
    """Return height and width of tiles whose open pixels fill a block in part."""
    area = _FILL * BLOCK / max(open_share, _LEAST_OPEN)
    height = max(1, 2 ** round(math.log2(math.sqrt(area)) - 0.25))
    return height, max(1, round(area / height))
