"""Groups of similar patches denoised on a device, in NVIDIA Warp: the arithmetic of `low_rank.py`, to rounding.

A block of threads takes one group. Eigenvectors are found by Jacobi's method from one side (Hestenes 1958), which a
warp can do in step: of the covariance each thread holds two columns in registers, turns them until they are at right
angles, and hands one on, so that all pairs meet; in the end a column is an eigenvector times its eigenvalue. Denoised
patches are added up as integers, whose sum has no order: the same bits from run to run. Never run on a GPU so far.

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
from gs2ci.render.recording import TILED, Launcher

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
def patch_at(planes: wp.array(dtype=wp.float32), corner: int, width: int):
    """Return the pixels of a patch, given where its first one lies."""
    patch = Patch()
    for k in range(PIXELS):
        patch[k] = planes[corner + (k // PX) * width + k % PX]
    return patch


@wp.func
def mean_patch(
    planes: wp.array(dtype=wp.float32),
    base: int,
    corners: wp.array(dtype=wp.int32),
    first: int,
    count: int,
    width: int,
):
    """Return the mean of so many patches."""
    total = Patch()
    for m in range(count):
        total += patch_at(planes, base + corners[first + m], width)
    return total / wp.float32(count)


@wp.func
def pixel_at(p: int, width: int, of_plane: int):
    """Return how far a pixel of a patch in all planes lies from the patch's corner."""
    k = p % PIXELS
    return (p // PIXELS) * of_plane + (k // PX) * width + k % PX


@wp.func
def column_of(columns: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)), j: int):
    """Return a column of a tile in shared memory."""
    column = Patch()
    for k in range(PIXELS):
        column[k] = columns[k, j]
    return column


@wp.func
def same_pixel(
    planes: wp.array(dtype=wp.float32),
    pixel: int,
    corners: wp.array(dtype=wp.int32),
    first: int,
    members: int,
    lane: int,
    inside: bool,
    columns: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)),
):
    """Write a pixel of all patches less its mean into a column of each thread's own, and return the mean.

    A loop that is not written out takes few registers. Threads without a pixel write zeros.
    """
    total = wp.float32(0.0)
    for k in range(members):
        total += planes[pixel + corners[first + k]]
    mean = total / wp.float32(members)
    for k in range(members):
        columns[k, lane] = wp.where(inside, planes[pixel + corners[first + k]] - mean, 0.0)
    return mean


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


@wp.func
def weighted(
    a: Patch,
    b: Patch,
    lane: int,
    sweeps: int,
    pairs: int,
    noise: wp.float32,
    threshold: wp.float32,
    uppers: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)),
    lowers: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)),
    weights: wp.tile(dtype=wp.float32, shape=(2, _THREADS)),
):
    """Find eigenvectors and their weights, in shared memory; of a symmetric matrix each thread has two columns.

    `pairs` is `PAIRS` again: a loop over a constant would be written out.
    """
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


@wp.func
def restored_from(
    centred: Patch,
    mean: Patch,
    pairs: int,
    uppers: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)),
    lowers: wp.tile(dtype=wp.float32, shape=(SIDE * SIDE, _THREADS)),
    weights: wp.tile(dtype=wp.float32, shape=(2, _THREADS)),
):
    """Return the weighted parts of a row along the eigenvectors, and its mean."""
    restored = mean
    for j in range(pairs):
        if weights[0, j] > 0.0:
            column = column_of(uppers, j)
            restored += column * (weights[0, j] * wp.dot(column, centred))
        if weights[1, j] > 0.0:
            column = column_of(lowers, j)
            restored += column * (weights[1, j] * wp.dot(column, centred))
    return restored


@wp.func
def added(sums: wp.array(dtype=wp.int64), pixel: int, value: wp.float32):
    """Add a value to a sum."""
    wp.atomic_add(sums, pixel, wp.int64(FIXED * wp.clamp(value, -LARGEST, LARGEST)))


@wp.kernel(module="unique", module_options={**TILED, "max_unroll": SIDE * SIDE})
def shrink_groups(
    planes: wp.array(dtype=wp.float32),
    corners: wp.array(dtype=wp.int32),
    groups: int,
    members: int,
    width: int,
    of_plane: int,
    sweeps: int,
    pairs: int,
    noise: wp.float32,
    threshold: wp.float32,
    sums: wp.array(dtype=wp.int64),
):
    """Denoise one group of one plane, and add its patches up. See `low_rank.shrink_group`."""
    block, lane = wp.tid()
    plane = block // groups
    base = plane * of_plane
    member = (block - plane * groups) * members
    own = wp.min(lane, PAIRS - 1)
    first = (own // PX) * width + own % PX
    second = ((own + PAIRS) // PX) * width + (own + PAIRS) % PX
    mean = mean_patch(planes, base, corners, member, members, width)
    first_mean = wp.float32(0.0)
    second_mean = wp.float32(0.0)
    for m in range(members):
        corner = base + corners[member + m]
        first_mean += planes[corner + first]
        second_mean += planes[corner + second]
    first_mean = first_mean / wp.float32(members)
    second_mean = second_mean / wp.float32(members)
    a = Patch()
    b = Patch()
    for m in range(members):
        corner = base + corners[member + m]
        centred = patch_at(planes, corner, width) - mean
        a += centred * (planes[corner + first] - first_mean)
        b += centred * (planes[corner + second] - second_mean)
    if lane >= PAIRS:
        a = Patch()
        b = Patch()
    uppers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    lowers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    weights = wp.tile_zeros(shape=(2, B), dtype=wp.float32, storage="shared")
    weighted(a, b, lane, sweeps, pairs, noise, threshold, uppers, lowers, weights)
    mean = mean_patch(planes, base, corners, member, members, width)
    for m in range(lane, members, B):
        corner = base + corners[member + m]
        centred = patch_at(planes, corner, width) - mean
        restored = restored_from(centred, mean, pairs, uppers, lowers, weights)
        for k in range(PIXELS):
            added(sums, corner + (k // PX) * width + k % PX, restored[k])


@wp.kernel(module="unique", module_options={**TILED, "max_unroll": SIDE * SIDE})
def shrink_together(
    planes: wp.array(dtype=wp.float32),
    corners: wp.array(dtype=wp.int32),
    pixels: int,
    members: int,
    threads: int,
    width: int,
    of_plane: int,
    sweeps: int,
    pairs: int,
    noise: wp.float32,
    threshold: wp.float32,
    sums: wp.array(dtype=wp.int64),
):
    """Denoise one group of all planes by the covariance of its patches, fewer than the pixels of one of them.

    `threads` is `B`, likewise.
    """
    block, lane = wp.tid()
    member = block * members
    uppers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    lowers = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    weights = wp.tile_zeros(shape=(2, B), dtype=wp.float32, storage="shared")
    rows = wp.tile_zeros(shape=(PIXELS, B), dtype=wp.float32, storage="shared")
    first = wp.min(lane, PAIRS - 1)
    a = Patch()
    b = Patch()
    for start in range(0, pixels, B):
        pixel = pixel_at(wp.min(start + lane, pixels - 1), width, of_plane)
        # Nobody writes before all have read.
        wp.tile_assign(weights, wp.tile(wp.vec2(0.0, 0.0)), offset=(0, 0))
        same_pixel(planes, pixel, corners, member, members, lane, start + lane < pixels, rows)
        wp.tile_assign(weights, wp.tile(wp.vec2(0.0, 0.0)), offset=(0, 0))
        for j in range(threads):
            column = column_of(rows, j)
            a += column * rows[first, j]
            b += column * rows[first + PAIRS, j]
    if lane >= PAIRS:
        a = Patch()
        b = Patch()
    weighted(a, b, lane, sweeps, pairs, noise, threshold, uppers, lowers, weights)
    for start in range(0, pixels, B):
        pixel = pixel_at(wp.min(start + lane, pixels - 1), width, of_plane)
        mean = same_pixel(planes, pixel, corners, member, members, lane, start + lane < pixels, rows)
        centred = column_of(rows, lane)
        restored = restored_from(centred, Patch(mean), pairs, uppers, lowers, weights)
        wp.tile_assign(rows, wp.tile(restored), offset=(0, 0))
        if start + lane < pixels:
            for k in range(members):
                added(sums, pixel + corners[member + k], rows[k, lane])


ALL: Final[tuple[Any, ...]] = (shrink_groups, shrink_together)
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
    place, in_plane = str(arrays[0].device.alias), (width, planes[0].size)
    if len(planes) > 1 and members < SIDE * SIDE:
        kernel, blocks, spread = shrink_together, groups, members * len(planes)
        sizes = (len(planes) * SIDE * SIDE, members, _THREADS)
    else:
        kernel, blocks, spread, sizes = shrink_groups, groups * len(planes), members, (groups, members)
    levels = [spread * sigma**2, spread**0.5 * sigma**2]
    inputs = [*arrays[:2], *sizes, *in_plane, _SWEEPS, int(PAIRS), *levels]
    Launcher(place).blocks(kernel, blocks, _THREADS, inputs, arrays[2:])
    numbers = torch.from_numpy(patches_over(corners, (SIDE, SIDE), planes.shape[1:])).to(device)
    mean = (sums.double() / PER_UNIT / numbers.clamp(min=1)).float()
    # What is not finite is so everywhere: as integers it would not be seen.
    found: F32 = (torch.where(numbers > 0, mean, instead) + 0 * there.sum()).cpu().numpy()
    return found
