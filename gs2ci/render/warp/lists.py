"""Each block's Gaussians, nearest first: made by sorting.

Key of an entry: block in the upper half, bits of the depth in the lower, which for positive numbers are in its order.
The sort is stable, so that Gaussians of equal depth stay in the order of the scene.
"""

from dataclasses import dataclass, replace
from typing import Any, Protocol

import warp as wp
from warp import int32

from gs2ci.render.recording import Floats, Ints
from gs2ci.render.warp.coding import OpenBlocks
from gs2ci.render.warp.types import TiledCamera

wp.set_module_options({"enable_backward": False})


@wp.kernel
def emit(
    gaussians: int,
    camera: TiledCamera,
    boxes: wp.array(dtype=wp.vec4i),
    depths: Floats,
    starts: Ints,
    blocks_before: Ints,
    keys: wp.array(dtype=wp.int64),
    rows: Ints,
    owner: Ints,
):
    """Write a key for each block that a Gaussian of a view may touch; each has a row of its own for its gradient."""
    at = wp.tid()
    box = boxes[at]
    base = (at // gaussians) * camera.tiles_x * camera.tiles_y
    row = starts[at]
    bits = wp.int64(wp.cast(depths[at], int32))
    for ty in range(box[2], box[3] + 1):
        tile = base + ty * camera.tiles_x
        for block in range(blocks_before[tile + box[0]], blocks_before[tile + box[1] + 1]):
            keys[row] = (wp.int64(block) << wp.int64(32)) | bits
            rows[row] = row
            owner[row] = at
            row += 1


@wp.kernel
def find_ranges(keys: wp.array(dtype=wp.int64), total: int, begin: Ints, end: Ints):
    """Find where each block's list begins and ends among the sorted keys."""
    i = wp.tid()
    block = int32(keys[i] >> wp.int64(32))
    if i == 0:
        begin[block] = 0
    else:
        before = int32(keys[i - 1] >> wp.int64(32))
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
        starts: Where the rows of each Gaussian in each view begin, and where they end, [V * G + 1].
        keys: What they are sorted by, and room for the sort, [2 * total or more].
        rows: The entries' rows, block after block, nearest first, [2 * total or more].
        owner: The Gaussian and view, view * G + g, of each row, [total or more].
        begin: Where each block's list begins, [blocks].
        end: Where it ends, [blocks].
    """

    total: int
    starts: Any
    keys: Any
    rows: Any
    owner: Any
    begin: Any
    end: Any


class Projected(Protocol):
    """What a projection found: boxes and depths of each Gaussian in each view, [V * G], and counts, [V * G + 1]."""

    key: Any
    boxes: Any
    depths: Any
    counts: Any
    camera: Any


def list_gaussians(projected: Projected, room: BlockLists | None = None, spare: float = 0.0) -> BlockLists:
    """Make the lists from a projection.

    The number of entries is read back once; with a fixed capacity instead, shorter lists would be sorted in full.

    Args:
        projected: The projection.
        room: Lists of the same population and masks, whose memory is written to if it is large enough.
        spare: Share by which new memory is larger than needed, so that it serves the next lists too.
    """
    coding: OpenBlocks = projected.key.coding
    device, pairs = coding.device, len(projected.counts) - 1
    starts = wp.empty(pairs + 1, dtype=int32, device=device) if room is None else room.starts
    with wp.ScopedDevice(device):  # Warp scans and sorts on the device that is current, wherever arrays lie
        wp.utils.array_scan(projected.counts, starts, inclusive=False)
    total = int(starts[-1:].numpy()[0])
    if room is not None and total <= len(room.owner):
        lists = replace(room, total=total)
        lists.begin.zero_()
        lists.end.zero_()
    else:
        size = max(1, int(total * (1 + spare)))
        # The sort works in arrays of twice the length; what is freed goes back to the driver, which takes long.
        keys = wp.empty(2 * size, dtype=wp.int64, device=device)
        rows, owner = (wp.empty(times * size, dtype=int32, device=device) for times in (2, 1))
        begin, end = (wp.zeros(coding.blocks, dtype=int32, device=device) for _ in range(2))
        lists = BlockLists(total, starts, keys, rows, owner, begin, end)
    if total:
        _fill(lists, projected, coding)
    return lists


def _fill(lists: BlockLists, projected: Projected, coding: OpenBlocks) -> None:
    """Write the entries, sort them, and find each block's."""
    device, total, keys = coding.device, lists.total, lists.keys
    wp.launch(
        emit,
        dim=len(projected.boxes),
        inputs=[
            *(projected.key.gaussians, projected.camera, projected.boxes, projected.depths),
            *(lists.starts, coding.blocks_before),
        ],
        outputs=[keys, lists.rows, lists.owner],
        device=device,
    )
    with wp.ScopedDevice(device):
        wp.utils.radix_sort_pairs(keys, lists.rows, total, 0, 32 + max(1, coding.blocks.bit_length()))
    wp.launch(find_ranges, dim=total, inputs=[keys, total], outputs=[lists.begin, lists.end], device=device)
