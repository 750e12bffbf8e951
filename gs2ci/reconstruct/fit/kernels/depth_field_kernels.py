"""Apply a field over pictures and inverse depths to Gaussians and to depth maps, and compute its gradient.

The field is given at the knots of a grid over (u, v, 1/z) of a reference view and is linear between them in each;
outside it has the value of the nearest point of the grid. The tests compare the kernels with numpy in float64. One
thread, so that sums have one order. Here: the kernels. Not here: steps and settings (`surfaces/depth_field.py`).
"""

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import f32_1, f32_2, f64, f64_1, f64_2, f64_3, helper, i64_1, kernel
from gs2ci.reconstruct.fit.kernels.distances import bounded, seen_from, turned


@helper()
def _place(at: float, low: float, step: float, count: int) -> tuple[int, float]:
    """Return the knot below a position and the fraction of the way to the next."""
    along = min(max((at - low) / step, 0.0), count - 1.0)
    knot = min(int(along), count - 2)
    return knot, along - knot


@helper()
def _around(
    field: F64, u: float, v: float, w: float, low: F64, step: F64
) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """Return the knot of a field, [A, B, C], below a position, and the fractions of the way to the next ones."""
    i, a = _place(u, low[0], step[0], field.shape[0])
    j, b = _place(v, low[1], step[1], field.shape[1])
    k, c = _place(w, low[2], step[2], field.shape[2])
    return (i, j, k), (a, b, c)


@helper()
def _share(corner: tuple[int, int, int], fractions: tuple[float, float, float]) -> float:
    """Return how much one of the eight knots about a position counts."""
    di, dj, dk = corner
    a, b, c = fractions
    return (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)


@helper()
def _value(field: F64, u: float, v: float, w: float, low: F64, step: F64) -> float:
    """Return the field, [A, B, C], at a position."""
    (i, j, k), fractions = _around(field, u, v, w, low, step)
    found = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                found += _share((di, dj, dk), fractions) * field[i + di, j + dj, k + dk]
    return found


@kernel(f32_2, f32_2, f32_2, f64_2, f64, f64_1, f64_1, f64_3)
def gather_gradient(means, by_means, by_log_scales, pose, near, low, step, gradient):
    """Store the gradient by the field's knots, [A, B, C], given those by means and log sizes, [G, 3] each.

    Added to inverse depth, b moves a point X of the reference view by -z b X, and sizes with it.

    Args:
        means: [G, 3].
        by_means: [G, 3].
        by_log_scales: [G, 3].
        pose: Of the reference view, [4, 4].
        near: The least depth: what is nearer does not count.
        low: The first knots' u, v and 1/z, [3].
        step: Between knots, [3].
        gradient: [A, B, C].
    """
    gradient[:] = 0
    for g in range(len(means)):
        x, y, z = seen_from(means, pose, g)
        if z < near:
            continue
        seen, by_mean = (x, y, z), turned(by_means, pose, g)
        total = 0.0
        for row in range(3):
            total += by_mean[row] * seen[row]
            total += by_log_scales[g, row]
        total *= -z
        (i, j, k), fractions = _around(gradient, x / z, y / z, 1 / z, low, step)
        for di in range(2):
            for dj in range(2):
                for dk in range(2):
                    gradient[i + di, j + dj, k + dk] += _share((di, dj, dk), fractions) * total


@kernel(f32_2, f32_2, f64_2, f64, f64_1, f64_1, f64_3)
def move_gaussians(means, log_scales, pose, near, low, step, field):
    """Add a field, [A, B, C], to the inverse depths of Gaussians, in place, within the bounds of `distances`."""
    for g in range(len(means)):
        x, y, z = seen_from(means, pose, g)
        if z < near:
            continue
        growth = bounded(-z * _value(field, x / z, y / z, 1 / z, low, step), z)
        for j in range(3):
            means[g, j] += growth * (x * pose[0, j] + y * pose[1, j] + z * pose[2, j])
            log_scales[g, j] += growth


@kernel(f32_1, i64_1, f32_2, f64_2, f64_1, f64_1, f64_3)
def move_map(inverse_depth, pixels, rays, to_reference, low, step, field):
    """Add a field, [A, B, C], to a view's inverse depths, [H * W], at some pixels, in place.

    Args:
        inverse_depth: [H * W].
        pixels: Which, flat indices, [P].
        rays: Where pixels look at z = 1, [H * W, 2].
        to_reference: The reference view's pose seen from this view, [4, 4].
        low: See `gather_gradient`.
        step: See `gather_gradient`.
        field: [A, B, C].
    """
    m = to_reference
    for at in pixels:
        u, v, w = rays[at, 0], rays[at, 1], inverse_depth[at]
        # In units of the depth: X = R ray + t w.
        x = m[0, 0] * u + m[0, 1] * v + m[0, 2] + m[0, 3] * w
        y = m[1, 0] * u + m[1, 1] * v + m[1, 2] + m[1, 3] * w
        z = m[2, 0] * u + m[2, 1] * v + m[2, 2] + m[2, 3] * w
        if w > 0 and z > 0:
            inverse_depth[at] = max(w + _value(field, x / z, y / z, w / z, low, step), 0.0)
