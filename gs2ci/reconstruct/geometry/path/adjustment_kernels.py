"""Numba kernels of the bundle adjustment: its cost, and the blocks of its normal equations.

One thread, float64, sums in the order of views and points: the same input gives the same bits. The tests hold the
blocks to JᵀWJ of the Jacobian in `motion`, and that to finite differences.
"""

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.kernels import EXACT, b1_2, f64, f64_1, f64_2, f64_3, helper, kernel

# Depth, relative to that in the reference view, at or below which a point counts as behind a camera; the cost goes on
# from there as if the depth did not fall further.
LEAST_RELATIVE_DEPTH = 1e-3


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


# Here rather than in numpy, whose threads cost more than they give on matrices this small.
def eliminate_depths(A: F64, b: F64, C: F64, d: F64, E: F64) -> tuple[F64, F64]:
    """Reduce damped normal equations to the poses: A − E C⁻¹ Eᵀ and b − E C⁻¹ d, [6 N, 6 N] and [6 N]."""
    unknowns = E.shape[1]
    system, right = np.zeros((unknowns, unknowns)), np.array(b, np.float64).reshape(unknowns)
    for i, block in enumerate(A):
        system[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = block
    _eliminate(C, d, E, system, right)
    return system, right


@kernel(f64_1, f64_1, f64_2, f64_2, f64_1, fastmath=EXACT)
def _eliminate(C, d, E, system, right):
    unknowns = E.shape[1]
    for p in range(C.shape[0]):
        row = E[p]
        for m in range(unknowns):
            share = row[m] / C[p]
            if share != 0:  # a view that does not see the point
                right[m] -= share * d[p]
                # The lower half; the system is symmetric.
                for n in range(m + 1):
                    system[m, n] -= share * row[n]
    for m in range(unknowns):
        for n in range(m):
            system[n, m] = system[m, n]


@kernel(f64_1, f64_1, f64_2, f64_1, fastmath=EXACT)
def depth_steps(C: F64, d: F64, E: F64, pose_step: F64) -> F64:
    """Solve for the inverse depths once the poses are known: C⁻¹ (d − Eᵀ step), [P]."""
    steps = np.empty_like(d)
    for p in range(len(C)):
        rest = d[p]
        for m in range(len(pose_step)):
            rest -= E[p, m] * pose_step[m]
        steps[p] = rest / C[p]
    return steps
