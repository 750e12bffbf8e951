"""Numba kernels of the bundle adjustment: its cost, the blocks of its normal equations, and the whole descent.

One thread, float64, sums in the order of views and points: the same input gives the same bits. The tests hold the
blocks to JᵀWJ of the Jacobian in `motion`, and that to finite differences.
"""

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.kernels import EXACT, b1_2, f64, f64_1, f64_2, f64_3, helper, i64, kernel

# Depth, relative to that in the reference view, at or below which a point counts as behind a camera; the cost goes on
# from there as if the depth did not fall further.
LEAST_RELATIVE_DEPTH = 1e-3
# Inverse depths stay within this range about their common scale 1: beyond it lie infinity and the lens itself.
INVERSE_DEPTH_RANGE = (0.02, 20.0)
# Keeps the normal equations of a view without tracks, or of a point without parallax, solvable; far smaller than any
# actual entries, which are in squared pixels.
REGULAR = 1e-9
_DAMPING_START, _DAMPING_LEAST, _DAMPING_MOST = 1e-3, 1e-8, 1e8


@kernel(f64_3, f64_2, f64_1, f64_2, f64_3, b1_2, f64_1, f64, fastmath=EXACT)
def normal_blocks(
    rotations: F64, translations: F64, inverse_depth: F64, rays: F64, seen_at: F64, seen: Bool, focal: F64, huber: float
) -> tuple[float, F64, F64, F64, F64, F64]:
    """Sum the Huber costs of all sightings, and accumulate JᵀWJ and −JᵀWr in blocks.

    Args:
        rotations: [N, 3, 3].
        translations: [N, 3].
        inverse_depth: [P].
        rays: In the reference view, third component 1, [P, 3].
        seen_at: [N, P, 2], in units of the focal length.
        seen: [N, P].
        focal: fx and fy, [2].
        huber: Residual from which on the cost is linear, px.

    Returns:
        The cost, px²; A [N, 6, 6] and b [N, 6] of the poses (ω, t), C [P] and d [P] of the inverse depths, E [P, 6 N]
        between them.
    """
    views, count = seen.shape
    A, b = np.zeros((views, 6, 6)), np.zeros((views, 6))
    C, d, E = np.zeros(count), np.zeros(count), np.zeros((count, 6 * views))
    by_pose, by_depth, error = np.zeros((2, 6)), np.zeros(2), np.zeros(2)
    cost = 0.0
    for i in range(views):
        for p in range(count):
            if not seen[i, p]:
                continue
            _linearise(
                rotations[i], translations[i], rays[p], inverse_depth[p], seen_at[i, p], focal, by_pose, by_depth, error
            )
            distance = np.hypot(error[0], error[1])
            cost += 0.5 * distance**2 if distance < huber else huber * (distance - 0.5 * huber)
            weight = 1.0 if distance < huber else huber / distance
            for k in range(2):
                for m in range(6):
                    weighted = weight * by_pose[k, m]
                    b[i, m] -= weighted * error[k]
                    E[p, 6 * i + m] += weighted * by_depth[k]
                    for n in range(6):
                        A[i, m, n] += weighted * by_pose[k, n]
                C[p] += weight * by_depth[k] ** 2
                d[p] -= weight * by_depth[k] * error[k]
    return cost, A, b, C, d, E


@helper(fastmath=EXACT)
def _linearise(
    R: F64, t: F64, ray: F64, rho: float, seen_at: F64, focal: F64, by_pose: F64, by_depth: F64, error: F64
) -> None:
    """Fill in the residual of one sighting and its derivatives by the pose, [2, 6], and the inverse depth, [2]."""
    a = R[0, 0] * ray[0] + R[0, 1] * ray[1] + R[0, 2]
    b = R[1, 0] * ray[0] + R[1, 1] * ray[1] + R[1, 2]
    c = R[2, 0] * ray[0] + R[2, 1] * ray[1] + R[2, 2]
    X, Y, Z = a + t[0] * rho, b + t[1] * rho, max(c + t[2] * rho, LEAST_RELATIVE_DEPTH)
    error[0] = focal[0] * (X / Z - seen_at[0])
    error[1] = focal[1] * (Y / Z - seen_at[1])
    # The rows of d r / d X are (fx, 0, sx) and (0, fy, sy); d(exp(ω) v)/dω = −[v]×, and row · −[v]× = v × row.
    fx, fy = focal[0] / Z, focal[1] / Z
    sx, sy = -fx * X / Z, -fy * Y / Z
    by_pose[0, 0], by_pose[0, 1], by_pose[0, 2] = b * sx, c * fx - a * sx, -b * fx
    by_pose[1, 0], by_pose[1, 1], by_pose[1, 2] = b * sy - c * fy, -a * sy, a * fy
    by_pose[0, 3], by_pose[0, 4], by_pose[0, 5] = fx * rho, 0.0, sx * rho
    by_pose[1, 3], by_pose[1, 4], by_pose[1, 5] = 0.0, fy * rho, sy * rho
    by_depth[0], by_depth[1] = fx * t[0] + sx * t[2], fy * t[1] + sy * t[2]


@helper(fastmath=EXACT)
def eliminate_depths(A: F64, b: F64, C: F64, d: F64, E: F64) -> tuple[F64, F64]:
    """Reduce normal equations to the poses: A − E C⁻¹ Eᵀ, of which the lower half is filled, and b − E C⁻¹ d."""
    unknowns = E.shape[1]
    system, right = np.zeros((unknowns, unknowns)), b.copy().reshape(unknowns)
    for i in range(len(A)):
        system[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = A[i]
    for p in range(len(C)):
        row = E[p]
        for m in range(unknowns):
            share = row[m] / C[p]
            if share != 0:  # a view that does not see the point
                right[m] -= share * d[p]
                for n in range(m + 1):
                    system[m, n] -= share * row[n]
    return system, right


@helper(fastmath=EXACT)
def solve_symmetric(system: F64, right: F64) -> bool:
    """Solve a positive definite system by Cholesky's method from its lower half, in place; return whether it is one."""
    unknowns = len(right)
    column = np.empty(unknowns)
    for k in range(unknowns):
        if not system[k, k] > 0:
            return False
        pivot = np.sqrt(system[k, k])
        for i in range(k, unknowns):
            column[i] = system[i, k] / pivot
            system[i, k] = column[i]
        right[k] /= pivot
        for i in range(k + 1, unknowns):
            right[i] -= column[i] * right[k]
            for j in range(k + 1, i + 1):
                system[i, j] -= column[i] * column[j]
    for k in range(unknowns - 1, -1, -1):
        right[k] /= system[k, k]
        for i in range(k):
            right[i] -= system[k, i] * right[k]
    return True


@helper(fastmath=EXACT)
def depth_steps(C: F64, d: F64, E: F64, pose_step: F64) -> F64:
    """Solve for the inverse depths once the poses are known: C⁻¹ (d − Eᵀ step), [P]."""
    steps = np.empty_like(d)
    for p in range(len(C)):
        steps[p] = (d[p] - (E[p] * pose_step).sum()) / C[p]
    return steps


@helper(fastmath=EXACT)
def _cross(a, b):
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@helper(fastmath=EXACT)
def _turn(rotation: F64, turn: F64) -> None:
    """Turn a rotation, [3, 3], in place, by a small turn, [3]: half of it is taken for the tangent of its half."""
    half = 0.5 * turn
    share = 2 / (1 + half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    for c in range(3):
        across = _cross(half, rotation[:, c])
        rotation[:, c] += share * (across + _cross(half, across))


@helper(fastmath=EXACT)
def _moved(rotations, translations, inverse_depth, A, b, C, d, E, damping):
    """Solve damped normal equations and move; inverse depths stay within their range. False: they have no solution."""
    damped, points = A.copy(), C * (1 + damping) + REGULAR
    for i in range(len(A)):
        for m in range(6):
            damped[i, m, m] += damping * A[i, m, m] + REGULAR
    # The reference view sees nothing, so that its step is 0.
    system, step = eliminate_depths(damped, b, points, d, E)
    solved = solve_symmetric(system, step)
    R, t = rotations.copy(), translations.copy()
    for i in range(len(A)):
        _turn(R[i], step[6 * i : 6 * i + 3])
        t[i] += step[6 * i + 3 : 6 * i + 6]
    least, most = INVERSE_DEPTH_RANGE
    depths = np.minimum(np.maximum(inverse_depth + depth_steps(points, d, E, step), least), most)
    return solved, R, t, depths


@kernel(f64_3, f64_2, f64_1, f64_2, f64_3, b1_2, f64_1, f64, i64, f64, fastmath=EXACT)
def descend(
    rotations: F64,
    translations: F64,
    inverse_depth: F64,
    rays: F64,
    seen_at: F64,
    seen: Bool,
    focal: F64,
    huber: float,
    iterations: int,
    tolerance: float,
) -> tuple[F64, F64, F64, float]:
    """Find a minimum of the Huber cost by Levenberg-Marquardt; the first arguments as for `normal_blocks`.

    Args:
        rotations: As there, as are the next six.
        translations: As there.
        inverse_depth: As there.
        rays: As there.
        seen_at: As there.
        seen: As there.
        focal: As there.
        huber: As there.
        iterations: At most so many accepted steps.
        tolerance: Relative decrease of the cost below which the adjustment has converged.

    Returns:
        Rotations, translations, inverse depths, and the cost.
    """
    R, t, rho = rotations, translations, inverse_depth
    cost, A, b, C, d, E = normal_blocks(R, t, rho, rays, seen_at, seen, focal, huber)
    damping = _DAMPING_START
    for _ in range(iterations):
        before = cost
        while damping < _DAMPING_MOST:
            solved, R1, t1, rho1 = _moved(R, t, rho, A, b, C, d, E, damping)
            if solved:
                trial = normal_blocks(R1, t1, rho1, rays, seen_at, seen, focal, huber)
                if trial[0] < cost:
                    R, t, rho = R1, t1, rho1
                    cost, A, b, C, d, E = trial
                    damping = max(damping / 3, _DAMPING_LEAST)
                    break
            damping *= 4
        if before - cost <= tolerance * before:
            break
    return R, t, rho, cost
