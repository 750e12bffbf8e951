"""Groups of similar patches denoised on a device, in NVIDIA Warp: the arithmetic of `low_rank.py`, to rounding.

A block of threads takes one group. Eigenvectors are found by Jacobi's method from one side (Hestenes 1958), which a
warp can do in step: of the covariance (of pixels, or of patches where planes are together) each thread holds two
columns in registers, turns them until they are at right angles, and hands one on, so that all pairs meet; in the end a
column is an eigenvector times its eigenvalue. Denoised patches are added up as integers, whose sum has no order: the
same bits from run to run. Never run on a GPU so far.

Here: the kernel and its call. Not here: why groups are shrunk so (`low_rank.py`), where their patches lie (`matching`).
"""

from typing import Any, Final

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.decode.patches.low_rank import patches_over
from gs2ci.reconstruct.decode.patches.matching import SIDE
from gs2ci.render.recording import TILED, Floats, Ints, Launcher

wp.init()

_THREADS: Final = 32
_SWEEPS: Final = 16
PER_UNIT: Final = 2**30
"""Integers per unit of a view's full scale, in sums."""
# A thread's columns lie in registers, so that a patch has one size.
PX = wp.constant(SIDE)
PIXELS = wp.constant(SIDE * SIDE)
PAIRS = wp.constant(SIDE * SIDE // 2)
B = wp.constant(_THREADS)
FIXED = wp.constant(wp.float32(PER_UNIT))
LARGEST = wp.constant(wp.float32(2.0**15))
ROUNDING = wp.constant(wp.float32(1e-6))
"""Columns that are so near to right angles stay as they are."""
NEAR = wp.constant(wp.float32(1e-3))
"""If no pair of a sweep was farther from right angles, the next one would find only rounding: angles are squared."""
NEGLIGIBLE = wp.constant(wp.float32(0.25))
"""Eigenvalues below this share of the noise's become 0 in any case, and need no angles."""
Patch = wp.types.vector(length=SIDE * SIDE, dtype=wp.float32)


@wp.func
def place_of(corners: Ints, member: int, width: int, of_plane: int, pixel: int, m: int):
    """Return where a pixel of one of the patches lies; those of all planes are counted through."""
    k = pixel % PIXELS
    return (pixel // PIXELS) * of_plane + corners[member + m] + (k // PX) * width + k % PX


@wp.func
def mean_of(planes: Floats, corners: Ints, member: int, members: int, width: int, of_plane: int, pixel: int):
    """Return the mean of a pixel over the patches."""
    total = wp.float32(0.0)
    for m in range(members):
        total += planes[place_of(corners, member, width, of_plane, pixel, m)]
    return total / wp.float32(members)


@wp.func
def place_in(corners: Ints, member: int, width: int, of_plane: int, plane: int, together: int, row: int, k: int):
    """Return where entry k of a row lies."""
    pixel = plane * PIXELS + k
    m = row
    if together > 0:
        pixel = row
        m = k
    return place_of(corners, member, width, of_plane, pixel, m)


@wp.func
def column_of(columns: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)), j: int):
    """Return a column of a tile in shared memory."""
    column = Patch()
    for k in range(PIXELS):
        column[k] = columns[k, j]
    return column


@wp.func
def turn(a: Patch, b: Patch, ab: wp.float32):
    """Turn two columns, whose product is given, into each other until they are at right angles."""
    zeta = (wp.dot(b, b) - wp.dot(a, a)) / (2.0 * ab)
    tangent = 1.0 / (wp.abs(zeta) + wp.sqrt(1.0 + zeta * zeta))
    if zeta < 0.0:
        tangent = -tangent
    cosine = 1.0 / wp.sqrt(1.0 + tangent * tangent)
    return (a - b * tangent) * cosine, (b + a * tangent) * cosine


@wp.func
def weight_of(value: wp.float32, noise: wp.float32, threshold: wp.float32):
    """See `low_rank._weigh`."""
    weight = wp.float32(0.0)
    if value > noise:
        weight = wp.max(1.0 - threshold / (wp.sqrt(value - noise) * wp.sqrt(value)), 0.0)
    return weight


@wp.kernel(module="unique", module_options={**TILED, "max_unroll": SIDE * SIDE})
def shrink_groups(
    planes: Floats,
    corners: Ints,
    groups: int,
    members: int,
    width: int,
    of_plane: int,
    rows: int,
    columns: int,
    together: int,
    threads: int,
    sweeps: int,
    pairs: int,
    noise: wp.float32,
    threshold: wp.float32,
    sums: wp.array(dtype=wp.int64),
):
    """Denoise one group of one plane, or of all planes together, and add its patches up. See `low_rank.shrink_group`.

    Patches are rows, or columns where planes are together. `pairs` is `PAIRS` again, `threads` is `B`: a loop over a
    constant would be written out, as are those over a patch's numbers in registers.
    """
    block, lane = wp.tid()
    plane = block // groups
    member = (block - plane * groups) * members
    uppers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    lowers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    centred = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    weights = wp.tile_zeros(shape=(2, B), dtype=wp.float32, storage="shared")
    means = wp.tile_zeros(shape=(PIXELS, 1), dtype=wp.float32, storage="shared")
    own = wp.min(lane, PAIRS - 1)
    first = plane * PIXELS + own
    means[own, 0] = mean_of(planes, corners, member, members, width, of_plane, first)
    means[own + PAIRS, 0] = mean_of(planes, corners, member, members, width, of_plane, first + PAIRS)
    a = Patch()
    b = Patch()
    for start in range(0, rows, threads):
        # Nobody writes before all have read; all wait whenever an entry is written.
        wp.tile_assign(weights, wp.tile(wp.vec2(0.0, 0.0)), offset=(0, 0))
        row = wp.min(start + lane, rows - 1)
        mean = wp.float32(0.0)
        if together > 0:
            mean = mean_of(planes, corners, member, members, width, of_plane, row)
        for k in range(columns):
            place = place_in(corners, member, width, of_plane, plane, together, row, k)
            value = planes[place] - wp.where(together > 0, mean, means[k, 0])
            centred[k, lane] = wp.where(start + lane < rows, value, 0.0)
        for j in range(threads):
            column = column_of(centred, j)
            a += column * centred[own, j]
            b += column * centred[own + PAIRS, j]
    if lane >= PAIRS:
        a = Patch()
        b = Patch()
    least = NEGLIGIBLE * noise
    for _sweep in range(sweeps):
        worst = wp.float32(0.0)
        for _turn in range(2 * pairs - 1):
            ab = wp.dot(a, b)
            angle = wp.abs(ab) / (wp.max(wp.length(a), least) * wp.max(wp.length(b), least))
            worst = wp.max(worst, angle)
            if angle > ROUNDING:
                a, b = turn(a, b, ab)
            # The first column stays, the others go round; nobody writes before all have read.
            wp.tile_assign(weights, wp.tile(wp.vec2(worst, worst)), offset=(0, 0))
            wp.tile_assign(uppers, wp.tile(a), offset=(0, 0))
            wp.tile_assign(lowers, wp.tile(b), offset=(0, 0))
            if lane == PAIRS - 1:
                b = a
            if lane < PAIRS - 1:
                b = column_of(lowers, lane + 1)
            if lane == 1:
                a = column_of(lowers, 0)
            if lane > 1 and lane < PAIRS:
                a = column_of(uppers, lane - 1)
        most = wp.tile_max(wp.tile(worst))
        if most[0] < NEAR:
            break
    of_a = wp.length(a)
    of_b = wp.length(b)
    kept = wp.vec2(weight_of(of_a, noise, threshold), weight_of(of_b, noise, threshold))
    wp.tile_assign(weights, wp.tile(kept), offset=(0, 0))
    wp.tile_assign(uppers, wp.tile(a / wp.max(of_a, least)), offset=(0, 0))
    wp.tile_assign(lowers, wp.tile(b / wp.max(of_b, least)), offset=(0, 0))
    for start in range(0, rows, threads):
        row = wp.min(start + lane, rows - 1)
        mean = wp.float32(0.0)
        if together > 0:
            mean = mean_of(planes, corners, member, members, width, of_plane, row)
        for k in range(columns):
            place = place_in(corners, member, width, of_plane, plane, together, row, k)
            value = planes[place] - wp.where(together > 0, mean, means[k, 0])
            centred[k, lane] = wp.where(start + lane < rows, value, 0.0)
        given = column_of(centred, lane)
        restored = Patch()
        for j in range(pairs):
            if weights[0, j] > 0.0:
                upper = column_of(uppers, j)
                restored += upper * (weights[0, j] * wp.dot(upper, given))
            if weights[1, j] > 0.0:
                lower = column_of(lowers, j)
                restored += lower * (weights[1, j] * wp.dot(lower, given))
        wp.tile_assign(centred, wp.tile(restored), offset=(0, 0))
        if start + lane < rows:
            for k in range(columns):
                place = place_in(corners, member, width, of_plane, plane, together, row, k)
                value = centred[k, lane] + wp.where(together > 0, mean, means[k, 0])
                wp.atomic_add(sums, place, wp.int64(FIXED * wp.clamp(value, -LARGEST, LARGEST)))


ALL: Final[tuple[Any, ...]] = (shrink_groups,)
"""For counts and for compiling in advance."""
THREADS: Final = _THREADS


def denoise_groups_on_device(
    planes: F32, corners: NDArray[np.int32], sigma: float, fallback: F32, device: torch.device
) -> F32:
    """Denoise planes by the same groups of similar patches; see `low_rank.denoise_groups`.

    Args:
        planes: [C, N, H, W] float32.
        corners: View, row and column of the upper left corner of each patch of each group, [G, M, 3] int32.
        sigma: Standard deviation of the noise.
        fallback: Values of pixels without a patch, [C, N, H, W].
        device: Where.
    """
    (groups, members), (height, width) = corners.shape[:2], planes.shape[2:]
    flat = (corners[..., 0] * height + corners[..., 1]) * width + corners[..., 2]
    there, at, instead = (torch.from_numpy(np.ascontiguousarray(one)).to(device) for one in (planes, flat, fallback))
    sums = torch.zeros(planes.shape, dtype=torch.int64, device=device)
    arrays = [wp.from_torch(one.view(-1)) for one in (there, at, sums)]
    place = str(arrays[0].device.alias)
    together = len(planes) > 1 and members < SIDE * SIDE
    if together:
        spread, blocks, rows, columns = members * len(planes), groups, len(planes) * SIDE * SIDE, members
    else:
        spread, blocks, rows, columns = members, groups * len(planes), members, SIDE * SIDE
    sizes = [groups, members, width, planes[0].size, rows, columns, int(together), _THREADS, _SWEEPS, int(PAIRS)]
    inputs = [*arrays[:2], *sizes, spread * sigma**2, spread**0.5 * sigma**2]
    Launcher(place).blocks(shrink_groups, blocks, _THREADS, inputs, arrays[2:])
    numbers = torch.from_numpy(patches_over(corners, (SIDE, SIDE), planes.shape[1:])).to(device)
    mean = (sums.double() / PER_UNIT / numbers.clamp(min=1)).float()
    # What is not finite is so everywhere: as integers it would not be seen.
    found: F32 = (torch.where(numbers > 0, mean, instead) + 0 * there.sum()).cpu().numpy()
    return found
