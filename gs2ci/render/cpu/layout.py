"""Where the pixels that count lie in memory: cells of 16 active pixels.

A mask set opens a quarter of the pixels, scattered; a vector of 16 neighbouring pixels would waste twelve lanes on
closed ones. So the open pixels are compacted, once per mask set: each view is cut into strips of a few rows, the open
pixels of a strip are listed column by column, and the list is cut into cells of exactly 16. An interval of columns in a
strip is then a contiguous range of cells. Behind a lens, strips and columns are those of the canvas on which the pixels
look.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.simd.vector import LANES

STRIP_ROWS_RANGE: Final = (2, 32)
_OPEN_SHARE_FLOOR: Final = 1e-3
# Gaussians are listed by the columns and rows whose centres they reach; a place within a pixel is this far from it.
_WITHIN_PIXEL_PX: Final = 0.5


@dataclass(frozen=True)
class Layout:
    """The cells of V views of one size.

    Args:
        views: V.
        size: Height and width of the images, H and W, px.
        height: Of the frame that Gaussians are projected into, px; H unless pixels look elsewhere.
        width: Likewise.
        margin_px: How far a pixel may look from the centre of its column and row.
        strip_rows: Rows in a strip.
        cell_start: The cells of view v are cell_start[v] ... cell_start[v + 1], [V + 1] int64.
        x: Where pixels look, at their centres without a lens, [cells * 16] float32. Spare lanes of a strip's last
            cell repeat its last pixel, so that they never keep a cell alive longer than its pixels do.
        y: Likewise.
        pixel: Row times W plus column of each lane, [cells * 16] int32.
        weight: Mask value of each lane, [cells * 16] float32; 0 in spare lanes.
        first: First cell of the strip (counted within its view) with a pixel at this column or right of it,
            [V, strips, width] int32.
        last: Last cell of the strip with a pixel at this column or left of it, [V, strips, width] int32.
    """

    views: int
    size: tuple[int, int]
    height: int
    width: int
    margin_px: float
    strip_rows: int
    cell_start: NDArray[np.int64]
    x: F32
    y: F32
    pixel: NDArray[np.int32]
    weight: F32
    first: NDArray[np.int32]
    last: NDArray[np.int32]

    @cached_property
    def cell_view(self) -> NDArray[np.int32]:
        """Get the view of each cell, [cells]."""
        return np.repeat(np.arange(self.views, dtype=np.int32), np.diff(self.cell_start))

    @property
    def strips(self) -> int:
        """Get the number of strips in a view."""
        return -(-self.height // self.strip_rows)

    @property
    def cells(self) -> int:
        """Get the number of cells in all views together."""
        return int(self.cell_start[-1])


def strip_rows_for(open_share: float) -> int:
    """Choose the strip height at which a cell covers a square patch: h * h * open_share = 16.

    Measured on masks of 25 % and 100 %: this is the fastest, and flat within a factor of 1.5 around it.
    """
    square = math.sqrt(LANES / max(open_share, _OPEN_SHARE_FLOOR))
    return int(np.clip(round(square), *STRIP_ROWS_RANGE))


def lay_out(masks: F32, strip_rows: int | None = None, sampling: CanvasSampling | None = None) -> Layout:
    """Compact the pixels with a positive mask value.

    Args:
        masks: [V, H, W] float32, not negative.
        strip_rows: Rows in a strip; None chooses by the share of open pixels.
        sampling: Where the pixels look; None is at their centres.
    """
    views, (height, width) = len(masks), (masks.shape[1:] if sampling is None else sampling.canvas)
    rows = strip_rows or strip_rows_for(float((masks > 0).sum() / (views * height * width)) if masks.size else 1.0)
    shape = (views, -(-height // rows), width)
    first, last = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    cell_start = np.zeros(views + 1, np.int64)
    x, y = _places(masks.shape[1:], sampling)
    # Column by column within a strip, and down each column: the pixels in this order are those of every view.
    slot = y.astype(np.int64) // rows * width + x.astype(np.int64)
    order = np.lexsort((y, slot))
    pixels: list[NDArray[np.int64]] = []
    weights: list[F32] = []
    for view in range(views):
        values = masks[view].reshape(-1)
        opened = order[values[order] > 0]
        counts = np.bincount(slot[opened], minlength=shape[1] * width).reshape(shape[1:])
        listed = counts.sum(axis=1)
        whole = -(-listed // LANES)
        begins, after = np.cumsum(whole) - whole, np.cumsum(listed)
        until = np.cumsum(counts, axis=1)
        first[view] = begins[:, None] + (until - counts) // LANES
        last[view] = begins[:, None] - 1 + -(-until // LANES)
        # A strip is filled up to whole cells by its last pixel, without weight.
        lanes = np.repeat(opened[after[listed > 0] - 1], whole[listed > 0] * LANES)
        lane_weights = np.zeros(len(lanes), np.float32)
        place = np.arange(len(opened)) + np.repeat(begins * LANES - (after - listed), listed)
        lanes[place], lane_weights[place] = opened, values[opened]
        pixels.append(lanes)
        weights.append(lane_weights)
        cell_start[view + 1] = cell_start[view] + whole.sum()
    pixel = np.concatenate(pixels) if pixels else np.zeros(0, np.int64)
    return Layout(
        views=views,
        size=(masks.shape[1], masks.shape[2]),
        height=height,
        width=width,
        margin_px=0.0 if sampling is None else _WITHIN_PIXEL_PX,
        strip_rows=rows,
        cell_start=cell_start,
        x=x[pixel].astype(np.float32),
        y=y[pixel].astype(np.float32),
        pixel=pixel.astype(np.int32),
        weight=np.concatenate(weights) if weights else np.zeros(0, np.float32),
        first=first,
        last=last,
    )


def _places(size: tuple[int, ...], sampling: CanvasSampling | None) -> tuple[F64, F64]:
    """Return where the pixels of an image look, row by row: x and y, [H * W]."""
    if sampling is not None:
        return sampling.places[..., 0].reshape(-1), sampling.places[..., 1].reshape(-1)
    pixel = np.arange(size[0] * size[1], dtype=np.float64)
    return pixel % size[1] + 0.5, pixel // size[1] + 0.5
