"""Numba kernels of the decoders, on planar float32 stacks.

Every task writes its own plane or row and no sum crosses tasks, so the result is bitwise the same for any number of
threads. The readable float64 statement of the same steps is in the tests
(`tests/reconstruct/decode/test_gap_tv.py`), which hold these kernels to it.
"""

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.kernels import EXACT, f32, f32_2, f32_3, f32_4, f64, f64_1, helper, i64, in_parts, kernel

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


def project_onto_measurement(
    views: F32,
    masks: F32,
    inverse_energy: F32,
    measured: F32,
    target: F32,
    noise: F32,
    error_power: float,
) -> F64:
    """Move the views towards the nearest ones that explain the measurement, in place.

    With the power of the noise σ² known, it is weighed against the error that the views have before the step, s² in
    each view: s² Φᵀ(y − Φx) / (s² Σ (wᵢ Mᵢ)² + σ²) is the best step, and the residual that is accumulated converges to
    the multiple that noise of this power leaves; see `pnp.ReadingNoise`.

    Args:
        views: x, [N, C, H, W]; changed to x + Φᵀ e (y₁ − Φx), less far where noise outweighs s².
        masks: wᵢ Mᵢ, [N, H, W].
        inverse_energy: e, for the nearest views 1 / Σ (wᵢ Mᵢ)², [H, W]; 0 at pixels that do not count.
        measured: y, [C, H, W].
        target: y₁, [C, H, W]; changed to y₁ + (y − Φx); where there is noise, to y and the kept share of what that has
            beyond it.
        noise: σ² e, [C, H, W]; of size 0: no noise.
        error_power: s².

    Returns:
        Σ (y − Φx)² of each row over the pixels that count, [C * H].
    """
    row_energy = np.zeros(views.shape[1] * views.shape[2])
    sums = (masks, inverse_energy, measured, target, noise, float(error_power), row_energy)
    in_parts(_project, len(row_energy), views, *sums)
    return row_energy


@kernel(i64, i64, f32_4, f32_3, f32_2, f32_3, f32_3, f32_3, f64, f64_1, fastmath=EXACT)
def _project(
    from_task,
    to_task,
    views,
    masks,
    inverse_energy,
    measured,
    target,
    noise,
    error_power,
    row_energy,
):
    n, _, height, width = views.shape
    for task in range(from_task, to_task):
        c, r = task // height, task % height
        change = np.zeros(width, np.float32)
        for i in range(n):
            for col in range(width):
                change[col] += masks[i, r, col] * views[i, c, r, col]
        energy = 0.0
        for col in range(width):
            residual = measured[c, r, col] - change[col]
            if inverse_energy[r, col] > 0:
                energy += residual * residual
            step = _ONE
            if noise.size and noise[c, r, col] > 0:
                share = noise[c, r, col] / np.float32(error_power)
                kept = max(_ZERO, _ONE - share)
                step = _ONE / max(_ONE, share)
                target[c, r, col] = measured[c, r, col] + kept * (target[c, r, col] - measured[c, r, col] + residual)
            else:
                target[c, r, col] += residual
            change[col] = (target[c, r, col] - change[col]) * inverse_energy[r, col] * step
        row_energy[task] = energy
        for i in range(n):
            for col in range(width):
                views[i, c, r, col] += masks[i, r, col] * change[col]


def are_finite(stack: F32) -> Bool:
    """Tell of each view of a stack, [N, C, H, W], whether all its numbers are finite, [N]."""
    # View by view, since memory may not hold a mark for each number of a large stack.
    return np.array([np.isfinite(view).all() for view in stack])


@helper(fastmath=EXACT)
def _primal_row(image: F32, dual_y: F32, dual_x: F32, weight: float, r: int, out: F32) -> None:
    """Write row r of image + weight * div(dual) to `out`."""
    # Above the first row stands the last, whose dual_y is 0.
    here, above = image[r], dual_y[r - 1]
    out[0] = here[0] + weight * (dual_y[r, 0] + dual_x[r, 0]) - weight * above[0]
    for col in range(1, len(out)):
        inflow = weight * (dual_y[r, col] + dual_x[r, col])
        out[col] = here[col] + inflow - weight * dual_x[r, col - 1] - weight * above[col]


@helper(fastmath=EXACT)
def _ascend_row(dual_y: F32, dual_x: F32, step: float, r: int, row: F32, below: F32) -> None:
    """Move the dual field of row r up the gradient of the image rows r and r + 1, then back into the unit disc."""
    last = row.shape[0] - 1
    for col in range(last):
        dy = dual_y[r, col] + step * (below[col] - row[col])
        dx = dual_x[r, col] + step * (row[col + 1] - row[col])
        scale = _ONE / max(_ONE, np.sqrt(dy * dy + dx * dx))
        dual_y[r, col] = dy * scale
        dual_x[r, col] = dx * scale
    # The last column has no right neighbour.
    dy = dual_y[r, last] + step * (below[last] - row[last])
    dual_y[r, last] = dy / max(_ONE, abs(dy))


@helper(fastmath=EXACT)
def _denoise_plane(image: F32, dual_y: F32, dual_x: F32, rows: F32, weight: float, step: float, inner: int) -> None:
    height = image.shape[0]
    dual_y[:] = 0
    dual_x[:] = 0
    # One sweep per inner iteration: primal row r needs the old dual rows r − 1 and r; once it is known, dual row
    # r − 1 is free to move. So the primal image never exists as a whole and everything stays in the cache.
    for _ in range(inner):
        for r in range(height):
            _primal_row(image, dual_y, dual_x, weight, r, rows[r % 2])
            if r == 0:
                continue
            _ascend_row(dual_y, dual_x, step, r - 1, rows[(r - 1) % 2], rows[r % 2])
        # The last row has no row below: against itself its vertical difference is 0, and its dual_y stays 0.
        last = (height - 1) % 2
        _ascend_row(dual_y, dual_x, step, height - 1, rows[last], rows[last])
    for r in range(height):
        _primal_row(image, dual_y, dual_x, weight, r, rows[0])
        for col in range(image.shape[1]):
            image[r, col] = rows[0, col]


def denoise_planes(planes: F32, weight: float, inner: int) -> None:
    """Lower the total variation of each plane, in place, by `inner` steps of projected gradient on the dual.

    Args:
        planes: [P, H, W].
        weight: λ of ½‖u − x‖² + λ TV(u), in units of the image.
        inner: Gradient steps of length 1 / (8 λ), each from a dual field that starts at 0 (Chambolle 2004).
    """
    in_parts(_denoise_planes, len(planes), planes, np.float32(weight), np.float32(1.0 / (8.0 * weight)), inner)


@kernel(i64, i64, f32_3, f32, f32, i64, fastmath=EXACT)
def _denoise_planes(from_plane, to_plane, planes, weight, step, inner):
    _, height, width = planes.shape
    for p in range(from_plane, to_plane):
        dual_y = np.empty((height, width), np.float32)
        dual_x = np.empty((height, width), np.float32)
        rows = np.empty((2, width), np.float32)
        _denoise_plane(planes[p], dual_y, dual_x, rows, weight, step, inner)


@kernel(i64, i64, f32_3, f32_4, f32, f32, f32_3, fastmath=EXACT)
def _coupled_primal(from_row, to_row, views, dual, weight, coupling, image):
    """Write views + weight * div(dual) to `image`; rows are those of all views."""
    height = views.shape[1]
    for row in range(from_row, to_row):
        i, r = row // height, row % height
        _coupled_primal_row(views, dual, weight, coupling, i, r, image[i, r])


@helper(fastmath=EXACT)
def _coupled_primal_row(views: F32, dual: F32, weight: float, coupling: float, i: int, r: int, out: F32) -> None:
    width = views.shape[2]
    for col in range(width):
        divergence = dual[0, i, r, col] + dual[1, i, r, col] + coupling * dual[2, i, r, col]
        if r > 0:
            divergence -= dual[0, i, r - 1, col]
        if col > 0:
            divergence -= dual[1, i, r, col - 1]
        if i > 0:
            divergence -= coupling * dual[2, i - 1, r, col]
        out[col] = views[i, r, col] + weight * divergence


@kernel(i64, i64, f32_4, f32_3, f32, f32, fastmath=EXACT)
def _coupled_ascend(from_row, to_row, dual, image, step, coupling):
    """Move the dual field up the gradient of the image, then back into the unit ball; rows are those of all views."""
    height = image.shape[1]
    for row in range(from_row, to_row):
        _coupled_ascend_row(dual, image, step, coupling, row // height, row % height)


@helper(fastmath=EXACT)
def _coupled_ascend_row(dual: F32, image: F32, step: float, coupling: float, i: int, r: int) -> None:
    views, height, width = image.shape
    for col in range(width):
        here = image[i, r, col]
        dy = dual[0, i, r, col] + (step * (image[i, r + 1, col] - here) if r + 1 < height else 0)
        dx = dual[1, i, r, col] + (step * (image[i, r, col + 1] - here) if col + 1 < width else 0)
        dt = dual[2, i, r, col] + (step * coupling * (image[i + 1, r, col] - here) if i + 1 < views else 0)
        scale = _ONE / max(_ONE, np.sqrt(dy * dy + dx * dx + dt * dt))
        dual[0, i, r, col] = dy * scale
        dual[1, i, r, col] = dx * scale
        dual[2, i, r, col] = dt * scale


def denoise_coupled(views: F32, weight: float, coupling: float, inner: int) -> None:
    """Lower the total variation of a stack of planes, differences between consecutive planes included, in place.

    Args:
        views: [N, H, W], in the order of exposure.
        weight: λ of ½‖u − x‖² + λ TV(u), in units of the image.
        coupling: Weight of a difference between views relative to one between pixels.
        inner: Gradient steps of length 1 / ((8 + 4 coupling²) λ), from a dual field that starts at 0.
    """
    count, height, width = views.shape
    dual = np.zeros((3, count, height, width), np.float32)
    image = np.empty_like(views)
    weight32, coupling32 = np.float32(weight), np.float32(coupling)
    step32 = np.float32(1.0 / ((8.0 + 4.0 * coupling * coupling) * weight))
    for iteration in range(inner + 1):
        in_parts(_coupled_primal, count * height, views, dual, weight32, coupling32, image)
        if iteration < inner:
            in_parts(_coupled_ascend, count * height, dual, image, step32, coupling32)
    views[:] = image
