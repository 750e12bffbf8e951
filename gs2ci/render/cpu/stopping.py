"""Where the light of each pixel is stopped: `gs2ci.render.stopping`, over the lists that a rendering made.

Here: what each Gaussian says of depth in each view, in numpy float64, and the kernel that finds the quantiles: plain
scalar code, as it runs a few times per reconstruction.
"""

from typing import Final

import numpy as np
from numba import prange

from gs2ci.core.arrays import F32, F64
from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN, DILATION_PX2, LOG_SCALE_MAX, NEAR, QUATERNION_NORM_MIN
from gs2ci.render.cpu.compile import kernel
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.lists import Lists
from gs2ci.render.cpu.passes import Inputs
from gs2ci.render.cpu.record import (
    ACROSS,
    ALONG,
    FIELDS,
    FOCAL_X,
    FOCAL_Y,
    LOG2_OPACITY,
    MEAN_X,
    MEAN_Y,
    SHEAR,
    U_HIGH,
    U_LOW,
    V_HIGH,
    V_LOW,
)
from gs2ci.render.cpu.vector import LANES
from gs2ci.render.stopping import (
    DEPTH_QUANTILE,
    NEARBY,
    PROFILE_REACH,
    PROFILE_SIGMA_RANGE,
    QUANTILE_SLACK,
    RATIO_MAX,
    RESOLUTION,
    SPREAD_QUANTILES,
)

# What a Gaussian says of depth in a view.
CENTRE_DEPTH: Final = 0
SLOPE_X: Final = 1  # of depth per px on screen, as a share of the centre's depth
SLOPE_Y: Final = 2
SIGMA: Final = 3  # along a ray, scene units
DEPTH_FIELDS: Final = 4

MAPS: Final = 4
"""Depth, spread, stopped, nearby: the order of `StoppedLight`."""

_LOG2_ALPHA_MIN: Final = float(np.log2(ALPHA_MIN))
_LOW_SHARE, _HIGH_SHARE = SPREAD_QUANTILES
_SIGMA_MIN, _SIGMA_MAX = PROFILE_SIGMA_RANGE
# A bracket is halved at least every other step, so that these suffice for `RESOLUTION` whatever the profiles are.
_STEPS_MAX: Final = 100
_CELLS_PER_TASK: Final = 64


def depth_fields(inputs: Inputs) -> F32:
    """Find each Gaussian's depth, its slopes on screen and its thickness in each view, [V, G, DEPTH_FIELDS]."""
    scales = np.exp(np.minimum(inputs.log_scales.astype(np.float64), LOG_SCALE_MAX))
    factor = _rotations(inputs.quaternions) * scales[:, None, :]
    camera = inputs.camera.astype(np.float64)
    means = np.broadcast_to(inputs.means, (len(inputs.poses), inputs.count, 3)).astype(np.float64)
    focal = camera[[FOCAL_X, FOCAL_Y]]
    fields = np.empty((len(inputs.poses), inputs.count, DEPTH_FIELDS), np.float32)
    for pose, centres, out in zip(inputs.poses.reshape(-1, 4, 4).astype(np.float64), means, fields, strict=True):
        points = centres @ pose[:3, :3].T + pose[:3, 3]
        depth = np.maximum(points[:, 2], NEAR)
        slopes = np.clip(points[:, :2] / depth[:, None], camera[[U_LOW, V_LOW]], camera[[U_HIGH, V_HIGH]])
        shape = pose[:3, :3] @ factor
        along = shape[:, 2]
        on_screen = (shape[:, :2] - slopes[:, :, None] * along[:, None]) * (focal / depth[:, None])[:, :, None]
        with_screen = np.einsum("gij,gj->gi", on_screen, along)
        covariance = on_screen @ on_screen.transpose(0, 2, 1) + DILATION_PX2 * np.eye(2)
        gain = np.linalg.solve(covariance, with_screen[:, :, None])[:, :, 0]
        variance = (along * along).sum(axis=1) - (gain * with_screen).sum(axis=1)
        out[:, CENTRE_DEPTH] = depth
        out[:, SLOPE_X : SLOPE_Y + 1] = gain / depth[:, None]
        out[:, SIGMA] = np.sqrt(np.maximum(variance, 0))
    return fields


def _rotations(quaternions: F32) -> F64:
    """Turn quaternions (w, x, y, z) of any norm, [G, 4], into matrices, [G, 3, 3]; too short ones into the identity."""
    q = quaternions.astype(np.float64)
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    w, x, y, z = np.where(norm >= QUATERNION_NORM_MIN, q / np.maximum(norm, QUATERNION_NORM_MIN), [1.0, 0, 0, 0]).T
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def stop_light(records: F32, lists: Lists, layout: Layout, fields: F32) -> F32:
    """Find the maps of `StoppedLight`, [MAPS, V, H, W], from a rendering's records and lists.

    Args:
        records: Projected Gaussians, [V, blocks * 256].
        lists: Those that touch a pixel of each cell.
        layout: The cells; every pixel is in one.
        fields: Of `depth_fields`.
    """
    maps = np.zeros((MAPS, layout.views, layout.size[0] * layout.size[1]), np.float32)
    longest = int(lists.entries.max()) if layout.cells else 0
    _stop_light(
        records.reshape(-1),
        layout.cell_view,
        layout.x,
        layout.y,
        layout.pixel,
        layout.weight,
        lists.start,
        lists.entries,
        lists.view_start,
        lists.gaussians,
        fields,
        longest,
        maps,
    )
    return maps.reshape(MAPS, layout.views, *layout.size)


@kernel()
def _gather(records, base, gaussians, begin, count, fields, x, y, weights, depths, reaches):
    """List what stops light at one pixel, front to back; returns how many do and what share passes."""
    through, kept = 1.0, 0
    for i in range(begin, begin + count):
        gaussian = gaussians[i]
        at = base + np.int64(gaussian) * FIELDS
        dx, dy = x - records[at + MEAN_X], y - records[at + MEAN_Y]
        t = dx + records[at + SHEAR] * dy
        log2_alpha = records[at + LOG2_OPACITY] - records[at + ACROSS] * t * t - records[at + ALONG] * dy * dy
        if log2_alpha < _LOG2_ALPHA_MIN:
            continue
        alpha = min(2.0**log2_alpha, ALPHA_MAX)
        field = fields[gaussian]
        share = field[SLOPE_X] * dx + field[SLOPE_Y] * dy
        depth = field[CENTRE_DEPTH] / max(1.0 - share, 1.0 / RATIO_MAX)
        weights[kept] = alpha * through
        depths[kept] = depth
        reaches[kept] = PROFILE_REACH * min(max(field[SIGMA], _SIGMA_MIN * depth), _SIGMA_MAX * depth)
        through *= 1.0 - alpha
        kept += 1
    return kept, through


@kernel()
def _before(limit, weights, depths, inverses, count):
    """Return what is stopped before a depth, and its derivative; `inverses` are those of the reaches."""
    total, density = 0.0, 0.0
    for i in range(count):
        along = min(max((limit - depths[i]) * inverses[i], -1.0), 1.0)
        square = along * along
        total += weights[i] * (0.5 + along * (0.75 - 0.25 * square))
        density += weights[i] * 0.75 * (1.0 - square) * inverses[i]
    return total, density


@kernel()
def _within(near, far, begin, count, profiles):
    """List, from `begin` on, the profiles that the bracket cuts; return how many, and the weight of those before it.

    Those that it does not cut contribute all or nothing anywhere within.
    """
    weights, depths, inverses = profiles
    kept, passed = begin, 0.0
    for i in range(count):
        start, end = (near - depths[i]) * inverses[i], (far - depths[i]) * inverses[i]
        if start >= 1.0:
            passed += weights[i]
        elif end > -1.0:
            weights[kept], depths[kept], inverses[kept] = weights[i], depths[i], inverses[i]
            kept += 1
    return kept - begin, passed


@kernel()
def _quantile(wanted, near, far, count, profiles):
    """Find the nearest depth before which `wanted` is stopped.

    Newton's steps, kept within a bracket that is halved at least every other step. Only the profiles that the bracket
    cuts are asked again, which soon are a few of many.

    Args:
        wanted: The weight that is to be stopped before it.
        near: No nearer than this.
        far: No farther than this.
        count: Number of profiles, P.
        profiles: Weights, depths and inverse reaches; the first P entries stay, the next P are overwritten.
    """
    weights, depths, inverses = profiles
    left, passed = _within(near, far, count, count, profiles)
    weights, depths, inverses = weights[count:], depths[count:], inverses[count:]
    rest = (weights, depths, inverses)
    guess = 0.5 * (near + far)
    for step in range(_STEPS_MAX):
        if far - near <= RESOLUTION * far:
            break
        total, density = _before(guess, weights, depths, inverses, left)
        total += passed
        reached = total >= wanted
        if reached:
            far = guess
        else:
            near = guess
        if left > 1:
            left, more = _within(near, far, 0, left, rest)
            passed += more
        guess = 0.5 * (near + far)
        if density > 0.0 and step % 2 == 0:
            # A little beyond the root, so that both bounds close in on it.
            newton = (far if reached else near) + (wanted - total) / density
            newton += -RESOLUTION * 0.25 * far if reached else RESOLUTION * 0.25 * far
            if near < newton < far:
                guess = newton
    return far


@kernel(parallel=True)
def _stop_light(records, cell_view, x, y, pixel, weight, start, entries, view_start, gaussians, fields, longest, maps):
    """Fill the maps, [MAPS, V, H * W]; `longest` is the length of the longest list."""
    cells = entries.shape[0]
    record_stride = records.shape[0] // max(view_start.shape[0] - 1, 1)
    for task in prange((cells + _CELLS_PER_TASK - 1) // _CELLS_PER_TASK):
        reaches = np.empty(longest)
        # Twice as long: the second half is `_quantile`'s.
        weights, depths, inverses = np.empty(2 * longest), np.empty(2 * longest), np.empty(2 * longest)
        profiles = (weights, depths, inverses)
        for cell in range(task * _CELLS_PER_TASK, min(cells, (task + 1) * _CELLS_PER_TASK)):
            view = cell_view[cell]
            base, begin = view * record_stride, view_start[view] + start[cell]
            for lane in range(cell * LANES, (cell + 1) * LANES):
                if weight[lane] == 0.0:
                    continue
                count, through = _gather(
                    records, base, gaussians, begin, entries[cell], fields[view], x[lane], y[lane],
                    weights, depths, reaches,
                )  # fmt: skip
                if count == 0:
                    continue
                total, near, far = 0.0, np.inf, 0.0
                for i in range(count):
                    total += weights[i]
                    near, far = min(near, depths[i] - reaches[i]), max(far, depths[i] + reaches[i])
                    inverses[i] = 1.0 / reaches[i]
                depth = _quantile((DEPTH_QUANTILE - QUANTILE_SLACK) * total, near, far, count, profiles)
                low = _quantile((_LOW_SHARE - QUANTILE_SLACK) * total, near, depth, count, profiles)
                high = _quantile((_HIGH_SHARE - QUANTILE_SLACK) * total, depth, far, count, profiles)
                behind, _ = _before(depth * (1.0 + NEARBY), weights, depths, inverses, count)
                ahead, _ = _before(depth * (1.0 - NEARBY), weights, depths, inverses, count)
                maps[0, view, pixel[lane]] = depth
                maps[1, view, pixel[lane]] = 0.5 * (depth / low - depth / high)
                maps[2, view, pixel[lane]] = 1.0 - through
                maps[3, view, pixel[lane]] = behind - ahead
