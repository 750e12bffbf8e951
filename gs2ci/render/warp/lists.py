"""Each block's Gaussians, nearest first: made by sorting, kept for the next renderings of the same population.

Key of an entry: block in the upper half, bits of the depth in the lower, which for positive numbers are in its order.
The sort is stable, so that Gaussians of equal depth stay in the order of the scene.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from gs2ci.render.interface import Reuse
from gs2ci.render.warp.coding import OpenBlocks
from gs2ci.render.warp.types import TiledCamera

wp.set_module_options({"enable_backward": False})


@wp.kernel
def emit(
    gaussians: int,
    camera: TiledCamera,
    boxes: wp.array(dtype=wp.vec4i),
    depths: wp.array(dtype=wp.float32),
    starts: wp.array(dtype=wp.int32),
    blocks_before: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.int64),
    rows: wp.array(dtype=wp.int32),
    owner: wp.array(dtype=wp.int32),
):
    """Write a key for each block that a Gaussian of a view may touch; each has a row of its own for its gradient."""
    at = wp.tid()
    box = boxes[at]
    base = (at // gaussians) * camera.tiles_x * camera.tiles_y
    row = starts[at]
    bits = wp.int64(wp.cast(depths[at], wp.int32))
    for ty in range(box[2], box[3] + 1):
        tile = base + ty * camera.tiles_x
        for block in range(blocks_before[tile + box[0]], blocks_before[tile + box[1] + 1]):
            keys[row] = (wp.int64(block) << wp.int64(32)) | bits
            rows[row] = row
            owner[row] = at
            row += 1


@wp.kernel
def find_ranges(
    keys: wp.array(dtype=wp.int64), total: int, begin: wp.array(dtype=wp.int32), end: wp.array(dtype=wp.int32)
):
    """Find where each block's list begins and ends among the sorted keys."""
    i = wp.tid()
    block = wp.int32(keys[i] >> wp.int64(32))
    if i == 0:
        begin[block] = 0
    else:
        before = wp.int32(keys[i - 1] >> wp.int64(32))
        if before != block:
            begin[block] = i
            end[before] = i
    if i == total - 1:
        end[block] = total


@dataclass(frozen=True)
class BlockLists:
    """Which Gaussians may touch which block.

    Args:
        total: Number of entries of all lists.
        starts: Where the rows of each Gaussian in each view begin, [V * G].
        counts: How many it has, [V * G].
        rows: The entries' rows, block after block, nearest first, [total].
        owner: The Gaussian and view, view * G + g, of each row, [total].
        begin: Where each block's list begins, [blocks].
        end: Where it ends, [blocks].
    """

    total: int
    starts: Any
    counts: Any
    rows: Any
    owner: Any
    begin: Any
    end: Any


def list_gaussians(
    boxes: Any, depths: Any, counts: Any, coding: OpenBlocks, camera: TiledCamera, gaussians: int
) -> BlockLists:
    """Make the lists from the projection's boxes, depths and counts, [V * G] each.

    The number of entries is read back once; with a fixed capacity instead, shorter lists would be sorted in full.
    """
    device, pairs = coding.device, len(counts)
    starts = wp.empty(pairs, dtype=wp.int32, device=device)
    begin = wp.zeros(coding.blocks, dtype=wp.int32, device=device)
    end = wp.zeros(coding.blocks, dtype=wp.int32, device=device)
    total = 0
    if pairs:
        wp.utils.array_scan(counts, starts, inclusive=False)
        total = int(starts[-1:].numpy()[0]) + int(counts[-1:].numpy()[0])
    room = max(total, 1)
    # The sort works in arrays of twice the length.
    keys = wp.empty(2 * room, dtype=wp.int64, device=device)
    rows = wp.empty(2 * room, dtype=wp.int32, device=device)
    owner = wp.empty(room, dtype=wp.int32, device=device)
    if total:
        wp.launch(
            emit,
            dim=pairs,
            inputs=[gaussians, camera, boxes, depths, starts, coding.blocks_before],
            outputs=[keys, rows, owner],
            device=device,
        )
        wp.utils.radix_sort_pairs(keys, rows, total, 0, 32 + max(1, coding.blocks.bit_length()))
        wp.launch(find_ranges, dim=total, inputs=[keys, total], outputs=[begin, end], device=device)
    return BlockLists(total, starts, counts, rows, owner, begin, end)


class WarpReuse(Reuse):
    """The lists of one population, for as many renderings as the settings say.

    Args:
        every: Renderings per listing.
        margin_px: Footprints count as wider by this on all sides when lists are made.
    """

    def __init__(self, every: int, margin_px: float) -> None:
        self.margin_px = margin_px
        self.listings = 0
        self._every = every
        self._kept: tuple[BlockLists, int, OpenBlocks] | None = None
        self._left = 0

    def kept(self, gaussians: int, coding: OpenBlocks) -> BlockLists | None:
        """Return lists that still serve, None if new ones are due."""
        if self._kept is None or self._left == 0 or self._kept[1] != gaussians or self._kept[2] is not coding:
            return None
        self._left -= 1
        return self._kept[0]

    def keep(self, lists: BlockLists, gaussians: int, coding: OpenBlocks) -> None:
        """Keep new lists, which have just served once."""
        self._kept, self._left = (lists, gaussians, coding), self._every - 1
        self.listings += 1
