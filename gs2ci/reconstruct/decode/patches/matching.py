"""Groups of similar patches: the positions of each group's patches.

Here: the lattice of reference patches, and the search for similar patches around positions that follow the motion. Not
here: the motion (`flow`), the denoising of a group (`low_rank`).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt

from gs2ci.core.arrays import F32, I32, Size
from gs2ci.core.bounds import Bounded
from gs2ci.core.errors import InputError
from gs2ci.core.kernels import EXACT, f32_1, helper, i32_2, i32_3, i64, in_parts, kernel
from gs2ci.reconstruct.decode.patches.eigen import REORDERED
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.render.simd.vector import LANES, any_ge, broadcast, fused, get, load, store, where_ge

_FARTHEST: Final = np.float32(np.finfo(np.float32).max)
# Reference views of each phase, by their number modulo the number of phases: far ones first.
_ORDERS: Final = {1: (0,), 2: (0, 1), 3: (0, 2, 1), 4: (0, 2, 1, 3)}


@dataclass(frozen=True)
class Lattice(Bounded):
    """The positions of reference patches, and the patches that are compared with them.

    Args:
        patch_px: Side of a patch.
        step_px: Distance between reference patches, along rows and columns.
        reach_px: Reach of the search for similar patches around the position that the motion predicts, along rows and
            columns.
        per_group: How many patches a group has, about the same number from each of its views.
        views: How many consecutive views a group uses.
        phases: Number of parts in which the lattice is used, one after the other. Each has other reference views, and
            all but the first are displaced by half a step.
    """

    patch_px: int = 6
    step_px: PositiveInt = 4
    reach_px: NonNegativeInt = 7
    per_group: PositiveInt = 64
    views: PositiveInt = 8
    phases: Annotated[int, Field(ge=1, le=len(_ORDERS))] = 4

    @property
    def side_by_side(self) -> "Lattice":
        """Get the lattice without overlap of patches: fewer than half as many as by default."""
        return replace(self, step_px=self.patch_px)

    def check(self) -> Self:
        """Return self if the numbers make sense.

        Raises:
            InputError: One is out of its bounds, or reference patches leave gaps between them.
        """
        if self.step_px > self.patch_px:
            raise InputError(f"patches of {self.patch_px} px, {self.step_px} px apart", allowed="step_px <= patch_px")
        return super().check()

    def parts(self, views: int) -> int:
        """Get the number of phases that so many views allow."""
        return min(self.phases, views)

    def references(self, phase: int, views: int) -> range:
        """Get the reference views of a phase."""
        parts = self.parts(views)
        return range(_ORDERS[parts][phase], views, parts)

    def window(self, at: int, views: int) -> Size:
        """Get the first view that the groups of view `at` use, and how many they use."""
        count = min(self.views, views)
        return min(max(at - count // 2, 0), views - count), count

    def patch(self, size: Size) -> Size:
        """Get height and width of a patch in a picture of height and width `size`."""
        return min(self.patch_px, size[0]), min(self.patch_px, size[1])

    def corners(self, phase: int, size: Size) -> I32:
        """Get the reference patches' upper left corners in each reference view, [G, 2]; they cover every pixel."""
        aside = self.step_px // 2
        starts = (aside * (phase in (1, 2)), aside * (phase in (1, 3)))
        lasts = [side - patch for side, patch in zip(size, self.patch(size), strict=True)]
        rows, columns = (
            sorted({0, last, *range(start, last + 1, self.step_px)}) for start, last in zip(starts, lasts, strict=True)
        )
        return np.array([(row, column) for row in rows for column in columns], np.int32)


def find_groups(guide: F32, flow: Flow, lattice: Lattice, phase: int) -> I32:
    """Find the groups of one phase of the lattice.

    Args:
        guide: Grey views in which patches are compared by the sum of their squared differences, [N, H, W] float32.
        flow: Of these views.
        lattice: Positions of reference patches, and how many similar ones are searched for.
        phase: Which part of the lattice.

    Returns:
        View, row and column of the upper left corner of each patch, [G, M, 3] int32. M is a little more than requested
        if it is not a multiple of the views, and less if there are not so many patches within reach.
    """
    size = (guide.shape[1], guide.shape[2])
    patch, corners = lattice.patch(size), lattice.corners(phase, size)
    middle = (np.array(patch) - 1) / 2
    found = []
    for at in lattice.references(phase, len(guide)):
        first, count = lattice.window(at, len(guide))
        around = np.rint(flow.follow(corners + middle, at, first, count) - middle)
        around = np.clip(around, -max(size), 2 * max(size)).astype(np.int32)
        each = min(-(-lattice.per_group // count), _within_reach(size, patch, lattice.reach_px))
        found.append(match_patches(guide, at, corners, around, first, patch, lattice.reach_px, each))
    return np.concatenate(found)


def _within_reach(size: Size, patch: Size, reach: int) -> int:
    rows, columns = (min(2 * reach + 1, side - p + 1) for side, p in zip(size, patch, strict=True))
    return rows * columns


def match_patches(
    views: F32,
    at: int,
    corners: I32,
    around: I32,
    first: int,
    patch: Size,
    reach: int,
    each: int,
) -> I32:
    """Find the patches most like each reference patch.

    Args:
        views: [N, H, W].
        at: View of the reference patches.
        corners: Row and column of their upper left corners, [G, 2].
        around: Row and column around which patches are searched for in each view from `first` on, [G, K, 2]. A window
            that leaves the picture is moved into it.
        first: The first of these views.
        patch: Height and width of a patch.
        reach: Reach of the search along rows and columns.
        each: How many are taken from each view; at most as many as a window contains.

    Returns:
        View, row and column of each patch, [G, K * each, 3] int32; among equals the first in order of rows.
    """
    found = np.empty((len(around), around.shape[1] * each, 3), np.int32)
    # Whole vectors are read, which may reach beyond the last pixel.
    pixels = np.zeros(views.size + LANES, np.float32)
    pixels[: views.size] = views.reshape(-1)
    size = (views.shape[1], views.shape[2])
    in_parts(_match, len(around), pixels, size, at, corners, around, first, patch, reach, each, found)
    return found


@kernel(i64, i64, f32_1, (i64, i64), i64, i32_2, i32_3, i64, (i64, i64), i64, i64, i32_3, fastmath=EXACT)
def _match(from_group, to_group, pixels, size, at, corners, around, first, patch, reach, each, found):
    count = around.shape[1]
    side = 2 * reach + 1
    height, width = size
    across = (side + LANES - 1) // LANES * LANES
    lanes = np.empty(across, np.float32)
    for c in range(across):
        lanes[c] = np.float32(c)
    for g in range(from_group, to_group):
        unlike = np.empty(side * across, np.float32)
        least = np.empty(each, np.float32)
        here = (at * height + corners[g, 0]) * width + corners[g, 1]
        for k in range(count):
            rows = min(side, height - patch[0] + 1)
            columns = min(side, width - patch[1] + 1)
            top = max(0, min(around[g, k, 0] - reach, height - patch[0] + 1 - rows))
            left = max(0, min(around[g, k, 1] - reach, width - patch[1] + 1 - columns))
            there = ((first + k) * height + top) * width + left
            _compare(pixels, width, here, there, patch, rows, columns, unlike, across, lanes)
            part = found[g, k * each : (k + 1) * each]
            _keep_least(unlike, rows, across, least, part)
            for m in range(each):
                part[m, 0] = first + k
                part[m, 1] += top
                part[m, 2] += left


@helper(fastmath=REORDERED)
def _compare(
    pixels: F32,
    width: int,
    here: int,
    there: int,
    patch: Size,
    rows: int,
    columns: int,
    unlike: F32,
    across: int,
    lanes: F32,
) -> None:
    """Write the squared differences of one patch from those around, rows of `across` numbers.

    Args:
        pixels: Of all views, [N * H * W] and one more vector.
        width: W.
        here: Offset of the patch.
        there: Offset of the first of the others.
        patch: Height and width.
        rows: Number of rows of other patches.
        columns: Number of columns of other patches; entries beyond them get the largest number.
        unlike: [rows * across].
        across: Number of columns rounded up to whole vectors.
        lanes: 0, 1, 2, ... across.
    """
    for r in range(rows):
        for b in range(0, across, LANES):
            total = broadcast(np.float32(0))
            for y in range(patch[0]):
                row, other = here + y * width, there + (r + y) * width + b
                for x in range(patch[1]):
                    # Beyond the last column of the last row there may be nothing to read.
                    difference = load(pixels, min(other + x, pixels.size - LANES)) - get(pixels, row + x)
                    total = fused(difference, difference, total)
            store(unlike, r * across + b, where_ge(load(lanes, b), np.float32(columns), _FARTHEST, total))


@helper(fastmath=EXACT)
def _keep_least(unlike: F32, rows: int, across: int, least: F32, places: I32) -> None:
    """Write row and column of the smallest numbers to `places`, after its first index, in ascending order."""
    each = least.shape[0]
    least[:] = _FARTHEST
    for r in range(rows):
        for b in range(0, across, LANES):
            if not any_ge(broadcast(least[each - 1]), load(unlike, r * across + b)):
                continue
            for c in range(b, b + LANES):
                value = unlike[r * across + c]
                if value >= least[each - 1]:
                    continue
                m = each - 1
                while m > 0 and least[m - 1] > value:
                    least[m] = least[m - 1]
                    places[m, 1], places[m, 2] = places[m - 1, 1], places[m - 1, 2]
                    m -= 1
                least[m] = value
                places[m, 1], places[m, 2] = r, c
