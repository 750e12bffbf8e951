"""The loss of a fit in Warp, one thread for each value of the measurement: as `ssim.py` and `objective.py` compute.

Images are flat, [H * W * C]. Here: the kernels, in the order in which they run. Not here: why they compute so
(`ssim.py`), their order (`device_losses.py`).
"""

from typing import Any, Final

import warp as wp
from warp import float32, float64, vec3

from gs2ci.reconstruct.fit.kernels.device.kernels import CHUNK, PER_THREAD, SUMMED, sum_of_block
from gs2ci.reconstruct.fit.losses.ssim import C1 as SSIM_C1
from gs2ci.reconstruct.fit.losses.ssim import C2 as SSIM_C2
from gs2ci.render.recording import TILED, Doubles, Floats, Vectors

wp.set_module_options({"enable_backward": False})

C1 = wp.constant(float32(SSIM_C1))
C2 = wp.constant(float32(SSIM_C2))
LEAST_BOTTOM = wp.constant(float32(0.5 * SSIM_C2))


@wp.kernel
def find_error(
    predicted: Floats,
    target: Floats,
    fitted: Floats,
    saturated: wp.array(dtype=wp.uint8),
    channels: int,
    per_exposure: float32,
    centred: Floats,
    error: Floats,
    counted: Floats,
    terms: Vectors,
):
    """Store a prediction's error e at the values that count, which they are, and e, e², eb."""
    i = wp.tid()
    pixel = i // channels
    seen = predicted[i] * per_exposure
    counts = fitted[pixel]
    if saturated[pixel] > wp.uint8(0) and seen > target[i]:
        counts = 0.0
    e = (seen - target[i]) * counts
    error[i] = e
    counted[i] = counts
    terms[i] = vec3(e, e * e, e * centred[i])


@wp.func
def along(values: Vectors, taps: Floats, i: int, at: int, extent: int, step: int):
    """Filter along a line of the image through value i, which stands at `at` of 0 to `extent`, in steps of `step`.

    What lies outside the image counts as zero.
    """
    total = vec3()
    for k in range(1 - taps.shape[0], taps.shape[0]):
        if at + k >= 0 and at + k < extent:
            total += taps[wp.abs(k)] * values[i + k * step]
    return total


@wp.func
def across(values: Vectors, taps: Floats, i: int, row: int, channels: int):
    """Filter along a row."""
    return along(values, taps, i, (i % row) // channels, row // channels, channels)


@wp.kernel
def compare(
    filtered: Vectors,
    mean: Floats,
    centred_mean: Floats,
    variance: Floats,
    taps: Floats,
    row: int,
    channels: int,
    apart: Floats,
    partial: Vectors,
):
    """Store 1 - similarity, and the similarity's derivatives by filtered e, e² and eb."""
    i = wp.tid()
    found = across(filtered, taps, i, row, channels)
    fe = found[0]
    cb = centred_mean[i]
    ma = mean[i] + fe
    difference = wp.max(found[1] - fe * fe, 0.0)
    bottom = wp.max(2.0 * variance[i] + 2.0 * (found[2] - fe * cb) + difference + C2, LEAST_BOTTOM)
    per_bottom = 1.0 / bottom
    unlike = difference * per_bottom
    per_means = 1.0 / (ma * ma + mean[i] * mean[i] + C1)
    darker = fe * fe * per_means
    structure = 1.0 - unlike
    slope = (1.0 - darker) * per_bottom
    by_luminance = 2.0 * (darker * ma - fe) * per_means
    apart[i] = darker + unlike - darker * unlike
    partial[i] = vec3(
        structure * by_luminance + 2.0 * slope * (fe - unlike * (cb + fe)), -(slope * structure), 2.0 * slope * unlike
    )


@wp.kernel
def filter_columns(
    values: Vectors,
    taps: Floats,
    height: int,
    row: int,
    out: Vectors,
):
    """Filter along columns."""
    i = wp.tid()
    out[i] = along(values, taps, i, i // row, height, row)


@wp.kernel
def find_gradient(
    filtered: Vectors,
    error: Floats,
    centred: Floats,
    counted: Floats,
    taps: Floats,
    row: int,
    channels: int,
    of_sign: float32,
    of_similarity: float32,
    gradient: Floats,
):
    """Store the loss's gradient: that of the absolute error and that of the similarity."""
    i = wp.tid()
    by = across(filtered, taps, i, row, channels)
    e = error[i]
    sign = float32(0.0)
    if e != 0.0:
        sign = wp.sign(e)
    gradient[i] = of_sign * sign - of_similarity * counted[i] * (by[0] + 2.0 * e * by[1] + centred[i] * by[2])


@wp.kernel(module="unique", module_options=TILED)
def sum_errors(error: Floats, apart: Floats, sums: wp.array(dtype=wp.vec2d)):
    """Sum absolute errors and 1 - similarity block by block."""
    block, lane = wp.tid()
    total = float64(0.0)
    unlike = float64(0.0)
    for k in range(PER_THREAD):
        i = block * CHUNK + k * SUMMED + lane
        if i < error.shape[0]:
            total += float64(wp.abs(error[i]))
            unlike += float64(apart[i])
    both = wp.vec2d(sum_of_block(total), sum_of_block(unlike))
    if lane == 0:
        sums[block] = both


@wp.kernel(module="unique", module_options=TILED)
def find_loss(sums: wp.array(dtype=wp.vec2d), of_error: float64, of_unlike: float64, loss: Doubles):
    """Weigh the two sums, by one block."""
    _block, lane = wp.tid()
    total = float64(0.0)
    for block in range(lane, sums.shape[0], wp.block_dim()):
        total += of_error * sums[block][0] + of_unlike * sums[block][1]
    all_of_it = sum_of_block(total)
    if lane == 0:
        loss[0] = all_of_it


ALL: Final[tuple[Any, ...]] = (*(find_error, filter_columns, compare, find_gradient, sum_errors, find_loss),)
"""For counts and for compiling in advance."""
