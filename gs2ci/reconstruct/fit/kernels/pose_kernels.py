"""Corrected poses exp(xi) T, and the gradient by xi, for all views of a fit in one call.

The same as `gs2ci.render.se3.exp` and its gradient by torch, whose forty small operations take longer than a small
picture's projection; tests compare these kernels with it. In float64 throughout. Here: the kernels. Not here: their use
(`optimiser/poses.py`), log, inverse, and angles of whole turns, which no correction reaches.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import f32_1, f32_2, f32_3, helper, kernel

_SERIES_BELOW_ANGLE2: Final = 0.25  # as in `se3`: the closed forms lose less than three digits above it
_TERMS: Final = 10


@helper()
def _series(angle2: float, first: int) -> tuple[float, float]:
    """Return sum_k (-x^2)^k / (2k + first)! and its derivative by x, divided by x; x^2 = `angle2`."""
    value, slope, term, factorial = 0.0, 0.0, 1.0, 1.0
    for n in range(2, first + 1):
        factorial *= n
    for k in range(_TERMS):
        value += term / factorial
        next_factorial = factorial * (2 * k + first + 1) * (2 * k + first + 2)
        slope -= 2.0 * (k + 1) * term / next_factorial
        term *= -angle2
        factorial = next_factorial
    return value, slope


@helper()
def _coefficients(angle2: float) -> tuple[float, float, float, float, float]:
    """Return a = sin x / x, b = (1 - cos x) / x^2, c = (x - sin x) / x^3, and b' / x and c' / x."""
    if angle2 < _SERIES_BELOW_ANGLE2:
        a, _ = _series(angle2, np.int64(1))
        b, b_slope = _series(angle2, np.int64(2))
        c, c_slope = _series(angle2, np.int64(3))
        return a, b, c, b_slope, c_slope
    angle = np.sqrt(angle2)
    sine, half = np.sin(angle), np.sin(angle / 2)
    a, b, c = sine / angle, 2 * half * half / angle2, (angle - sine) / (angle2 * angle)
    return a, b, c, (a - 2 * b) / angle2, (b - 3 * c) / angle2


@helper()
def _turned(phi: F64, b: float, c: float, sign: float, x: F64, out: F64) -> None:
    """Store (I + sign b [phi] + c [phi]^2) x: V x, and V^T x where the sign is -1."""
    p0, p1, p2 = phi[1] * x[2] - phi[2] * x[1], phi[2] * x[0] - phi[0] * x[2], phi[0] * x[1] - phi[1] * x[0]
    q0, q1, q2 = phi[1] * p2 - phi[2] * p1, phi[2] * p0 - phi[0] * p2, phi[0] * p1 - phi[1] * p0
    out[0] = x[0] + sign * b * p0 + c * q0
    out[1] = x[1] + sign * b * p1 + c * q1
    out[2] = x[2] + sign * b * p2 + c * q2


@kernel(f32_2, f32_1, f32_3, f32_3)
def correct_poses(twists: F32, units: F32, initial: F32, out: F32) -> None:
    """Store exp(units * twists) @ initial.

    Args:
        twists: [N, 6], translation first.
        units: Of their components, [6].
        initial: [N, 4, 4], with last rows (0, 0, 0, 1).
        out: [N, 4, 4].
    """
    rho, phi, column, moved = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(twists)):
        for i in range(3):
            rho[i] = np.float64(units[i]) * twists[n, i]
            phi[i] = np.float64(units[3 + i]) * twists[n, 3 + i]
        a, b, c, _, _ = _coefficients(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
        for j in range(4):
            for i in range(3):
                column[i] = initial[n, i, j]
            _turned(phi, a, b, 1.0, column, moved)  # R = I + a [phi] + b [phi]^2
            for i in range(3):
                out[n, i, j] = moved[i]
            if j == 3:
                _turned(phi, b, c, 1.0, rho, column)
                for i in range(3):
                    out[n, i, j] = moved[i] + column[i]
            out[n, 3, j] = initial[n, 3, j]


@kernel(f32_2, f32_1, f32_3, f32_3, f32_2)
def twist_gradient(twists: F32, units: F32, poses: F32, gradient: F32, out: F32) -> None:
    """Add the gradient by the twists to `out`, [N, 6].

    With G the gradient by the pose T = exp(rho, phi) T0, u its last column and t = R t0 + V rho: rho gets V^T u; phi
    gets V^T sum_j x_j x G_j over the columns x_j of R [R0 t0], since V is the left Jacobian of the rotation, and what
    u^T V rho has by phi.

    Args:
        twists: As for `correct_poses`.
        units: As there.
        poses: The result of `correct_poses`, [N, 4, 4].
        gradient: By the poses, [N, 4, 4]; the last rows do not count.
        out: [N, 6].
    """
    rho, phi, u, w = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    shift, by_rho, by_phi = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(twists)):
        for i in range(3):
            rho[i] = np.float64(units[i]) * twists[n, i]
            phi[i] = np.float64(units[3 + i]) * twists[n, 3 + i]
            u[i] = gradient[n, i, 3]
            w[i] = 0.0
        _, b, c, b_slope, c_slope = _coefficients(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
        _turned(phi, b, c, 1.0, rho, shift)
        for j in range(4):
            x0, x1, x2 = np.float64(poses[n, 0, j]), np.float64(poses[n, 1, j]), np.float64(poses[n, 2, j])
            if j == 3:
                x0, x1, x2 = x0 - shift[0], x1 - shift[1], x2 - shift[2]
            g0, g1, g2 = np.float64(gradient[n, 0, j]), np.float64(gradient[n, 1, j]), np.float64(gradient[n, 2, j])
            w[0] += x1 * g2 - x2 * g1
            w[1] += x2 * g0 - x0 * g2
            w[2] += x0 * g1 - x1 * g0
        _turned(phi, b, c, -1.0, u, by_rho)
        _turned(phi, b, c, -1.0, w, by_phi)
        dot_up = u[0] * phi[0] + u[1] * phi[1] + u[2] * phi[2]
        dot_rp = rho[0] * phi[0] + rho[1] * phi[1] + rho[2] * phi[2]
        dot_ur = u[0] * rho[0] + u[1] * rho[1] + u[2] * rho[2]
        angle2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
        # u . (phi x rho) and u . (phi x (phi x rho))
        r0, r1, r2 = rho[1] * u[2] - rho[2] * u[1], rho[2] * u[0] - rho[0] * u[2], rho[0] * u[1] - rho[1] * u[0]
        once = phi[0] * r0 + phi[1] * r1 + phi[2] * r2
        twice = dot_up * dot_rp - dot_ur * angle2
        along = b_slope * once + c_slope * twice
        by_phi[0] += along * phi[0] + b * r0 + c * (dot_up * rho[0] + dot_rp * u[0] - 2 * dot_ur * phi[0])
        by_phi[1] += along * phi[1] + b * r1 + c * (dot_up * rho[1] + dot_rp * u[1] - 2 * dot_ur * phi[1])
        by_phi[2] += along * phi[2] + b * r2 + c * (dot_up * rho[2] + dot_rp * u[2] - 2 * dot_ur * phi[2])
        for i in range(3):
            out[n, i] += units[i] * by_rho[i]
            out[n, 3 + i] += units[3 + i] * by_phi[i]
