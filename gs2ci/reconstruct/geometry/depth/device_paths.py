"""Paths of semi-global smoothing in Warp, one block of threads for each row or column. Never run on a GPU so far.

Here: one direction of them. Not here: what they compute and why (`kernels._walk`), the sweep (`device_sweep.py`).
"""

from typing import Any, Final

import torch
import warp as wp
from torch import Tensor
from warp import float32

from gs2ci.reconstruct.geometry.depth import kernels
from gs2ci.render.recording import TILED, Floats, Launcher

wp.init()

THREADS: Final = 32

SMALL_JUMP = wp.constant(float32(kernels.SMALL_JUMP))
LARGE_JUMP = wp.constant(float32(kernels.LARGE_JUMP))
FAR = wp.constant(float32(1e9))


@wp.kernel(module="unique", module_options=TILED)
def walk(
    cost: Floats,
    length: int,
    planes: int,
    apart: int,
    step: int,
    backwards: int,
    paths: Floats,
    total: Floats,
):
    """Walk along one line, planes side by side, and add the cheapest way to each plane of each pixel to the total."""
    line, lane = wp.tid()
    for i in range(length):
        along = i
        if backwards > 0:
            along = length - 1 - i
        at = line * apart + along * step
        own = (2 * line + i % 2) * planes
        before = (2 * line + (i + 1) % 2) * planes
        mine = FAR
        for d in range(lane, planes, wp.block_dim()):
            mine = wp.min(mine, paths[before + d])
        # Here all wait: what was written for the last pixel is read from now on, and what it read is written to.
        least = wp.tile_min(wp.tile(mine))
        lowest = least[0]
        for d in range(lane, planes, wp.block_dim()):
            beside = FAR
            if d > 0:
                beside = paths[before + d - 1]
            if d < planes - 1:
                beside = wp.min(beside, paths[before + d + 1])
            cheapest = wp.min(wp.min(paths[before + d], beside + SMALL_JUMP), lowest + LARGE_JUMP)
            way = cost[at + d] + (cheapest - lowest)
            paths[own + d] = way
            total[at + d] = total[at + d] + way


ALL: Final[tuple[Any, ...]] = (walk,)
"""For counts and for compiling in advance."""


def add_paths(cost: Tensor, total: Tensor, lines: tuple[int, int, int, int], *, backwards: bool) -> None:
    """Add the path costs of one direction.

    Args:
        cost: [H, W, D], in one piece of memory.
        total: Added to, likewise.
        lines: How many lines there are, how many pixels each has, and how many numbers are between the first pixels of
            two lines and between two pixels of one.
        backwards: Whether from the last pixel to the first.
    """
    (count, length, apart, step), planes = lines, cost.shape[2]
    # A path begins as from a pixel that cost nothing.
    paths = torch.zeros(2 * count * planes, device=cost.device)
    arrays = [wp.from_torch(one.view(-1)) for one in (cost, paths, total)]
    numbers = [length, planes, apart, step, int(backwards)]
    Launcher(str(arrays[0].device.alias)).blocks(walk, count, THREADS, [arrays[0], *numbers], arrays[1:])
