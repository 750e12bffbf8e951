"""Corrected poses exp(xi) T, and the gradient by xi, for all views of a fit in one call.

The same as `gs2ci.render.se3.exp` and its gradient by torch, whose forty small operations take longer than a small
picture's projection; tests compare these kernels with it. In float64 throughout. Here: the kernels. Not here: their use
(`optimiser/poses.py`), log, inverse, and angles of whole turns, which no correction reaches.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import f32_1, f32_2, f32_3, helper, kernel
from gs2ci.render.se3 import SERIES_BELOW_ANGLE2

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
    if angle2 < SERIES_BELOW_ANGLE2:
        a, _ = _series(angle2, np.int64(1))
        b, b_slope = _series(angle2, np.int64(2))
        c, c_slope = _series(angle2, np.int64(3))
        return a, b, c, b_slope, c_slope
    angle = np.sqrt(angle2)
    sine, half = np.sin(angle), np.sin(angle / 2)
    a, b, c = sine / angle, 2 * half * half / angle2, (angle - sine) / (angle2 * angle)
    return a, b, c, (a - 2 * b) / angle2, (b - 3 * c) / angle2


@helper()
def _cross(a: F64, b: F64) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@helper()
def _dot(a: F64, b: F64) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@helper()
def _turned(phi: F64, b: float, c: float, sign: float, x: F64, out: F64) -> None:
    """Store (I + sign b [phi] + c [phi]^2) x: V x, and V^T x where the sign is -1."""
    once = _cross(phi, x)
    twice = _cross(phi, once)
    for i in range(3):
        out[i] = x[i] + sign * b * once[i] + c * twice[i]


@kernel(f32_2, f32_1, f32_3, f32_3)
def correct_poses(twists, units, initial, out):
    """Store exp(units * twists) @ initial.

    Args:
        twists: [N, 6], translation first.
        units: Of their components, [6].
        initial: [N, 4, 4], with last rows (0, 0, 0, 1).
        out: [N, 4, 4].
    """
    rho, phi, column, moved = np.empty((4, 3))
    for n in range(len(twists)):
        for i in range(3):
            rho[i] = np.float64(units[i]) * twists[n, i]
            phi[i] = np.float64(units[3 + i]) * twists[n, 3 + i]
        a, b, c, _, _ = _coefficients(_dot(phi, phi))
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
def twist_gradient(twists, units, poses, gradient, out):
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
    rho, phi, u, w, x, g, shift, by_rho, by_phi = np.empty((9, 3))
    for n in range(len(twists)):
        for i in range(3):
            rho[i] = np.float64(units[i]) * twists[n, i]
            phi[i] = np.float64(units[3 + i]) * twists[n, 3 + i]
            u[i] = gradient[n, i, 3]
            w[i] = 0.0
        _, b, c, b_slope, c_slope = _coefficients(_dot(phi, phi))
        _turned(phi, b, c, 1.0, rho, shift)
        for j in range(4):
            for i in range(3):
                x[i] = poses[n, i, j] - (shift[i] if j == 3 else 0.0)
                g[i] = gradient[n, i, j]
            turning = _cross(x, g)
            for i in range(3):
                w[i] += turning[i]
        _turned(phi, b, c, -1.0, u, by_rho)
        _turned(phi, b, c, -1.0, w, by_phi)
        dot_up, dot_rp, dot_ur = _dot(u, phi), _dot(rho, phi), _dot(u, rho)
        r = _cross(rho, u)
        # u . (phi x rho) and u . (phi x (phi x rho))
        once, twice = _dot(phi, r), dot_up * dot_rp - dot_ur * _dot(phi, phi)
        along = b_slope * once + c_slope * twice
        for i in range(3):
            by_phi[i] += along * phi[i] + b * r[i] + c * (dot_up * rho[i] + dot_rp * u[i] - 2 * dot_ur * phi[i])
        for i in range(3):
            out[n, i] += units[i] * by_rho[i]
            out[n, 3 + i] += units[3 + i] * by_phi[i]
