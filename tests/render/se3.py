"""Rigid motions and their tangent vectors: exp and log of SO(3) and SE(3), in torch, any dtype.

A tangent vector is xi = (rho, phi), translation first, rotation vector second; `exp(xi)` is a 4 x 4 matrix that moves
points. Values and first derivatives are finite and accurate at every angle in [0, pi): small angles go through Taylor
series, and angles near pi through the quaternion, where neither the sine nor the trace is divided by. Equations: Sola,
Deray, Atchuthan, "A micro Lie theory for state estimation in robotics" (2018), eqs. 132-174.
"""

import math

import torch
from torch import Tensor

SERIES_BELOW_ANGLE2 = 0.25
"""Squared angle below which the series take over; the closed forms lose less than two digits above it."""
_SERIES_TERMS = 8
_CROSSES = ((0, 0, 0, 0, 0, -1, 0, 1, 0), (0, 0, 1, 0, 0, 0, -1, 0, 0), (0, -1, 0, 1, 0, 0, 0, 0, 0))
"""The cross-product matrices of the three axes, row by row."""
_HALF_COTANGENT = (1 / 3, 1 / 45, 2 / 945, 1 / 4725, 2 / 93555, 1382 / 638512875, 4 / 18243225)
"""1 - h cot h = sum_k c_k h^(2k), c_k = 2 zeta(2k) / pi^(2k); left out below h = 1/4: 1e-16 of the value."""


def _series(angle2: Tensor, first: int) -> Tensor:
    """Return sum_k (-angle2)^k / (2k + first)!, that is sinc, (1 - cos)/x^2, (x - sin)/x^3 for first = 1, 2, 3."""
    value = torch.zeros_like(angle2)
    for k in reversed(range(_SERIES_TERMS)):
        value = value * -angle2 + 1.0 / math.factorial(2 * k + first)
    return value


def _three_series(angle2: Tensor) -> Tensor:
    """Return `_series` for first = 1, 2 and 3, [..., 3], in two operations, as each iteration of a fit needs them."""
    powers = range(_SERIES_TERMS)
    table = [[(-1) ** k / math.factorial(2 * k + first) for first in (1, 2, 3)] for k in powers]
    exponents = torch.tensor(powers, dtype=angle2.dtype, device=angle2.device)
    return angle2[..., None].pow(exponents) @ torch.tensor(table, dtype=angle2.dtype, device=angle2.device)


def _split(angle2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return where the series apply, and safe arguments for the series and for the closed form elsewhere.

    `torch.where` passes zero times the unused branch's gradient back, so both branches must be finite everywhere.
    """
    small = angle2 < SERIES_BELOW_ANGLE2
    near = torch.where(small, angle2, torch.zeros_like(angle2))
    return small, near, torch.where(small, torch.ones_like(angle2), angle2)


def _coefficients(angle2: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return sin x / x, (1 - cos x) / x^2 and (x - sin x) / x^3 for x^2 = `angle2`."""
    if bool((angle2 < SERIES_BELOW_ANGLE2).all()):
        a, b, c = _three_series(angle2).unbind(-1)
        return a, b, c
    small, near, far2 = _split(angle2)
    far = far2.sqrt()
    sine = torch.sin(far)
    # 1 - cos x = 2 sin^2(x / 2), which does not cancel.
    a = torch.where(small, _series(near, 1), sine / far)
    b = torch.where(small, _series(near, 2), 2 * torch.sin(far / 2).square() / far2)
    c = torch.where(small, _series(near, 3), (far - sine) / (far2 * far))
    return a, b, c


def hat(phi: Tensor) -> Tensor:
    """Return the cross-product matrix of phi, [..., 3] -> [..., 3, 3]."""
    crosses = torch.tensor(_CROSSES, dtype=phi.dtype, device=phi.device)
    return (phi @ crosses).reshape(*phi.shape[:-1], 3, 3)


def so3_exp(phi: Tensor) -> Tensor:
    """Turn rotation vectors into rotation matrices, [..., 3] -> [..., 3, 3] (Rodrigues)."""
    a, b, _ = _coefficients((phi * phi).sum(-1))
    cross = hat(phi)
    eye = torch.eye(3, dtype=phi.dtype, device=phi.device)
    return eye + a[..., None, None] * cross + b[..., None, None] * (cross @ cross)


def so3_log(rotation: Tensor) -> Tensor:
    """Turn rotation matrices into rotation vectors of angle at most pi, [..., 3, 3] -> [..., 3].

    At exactly pi the axis' sign is arbitrary, and the derivative does not exist.
    """
    quaternion = _unit_quaternion(rotation)
    # q and -q are one rotation; w >= 0 picks the angle below pi.
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    w, vector = quaternion[..., 0], quaternion[..., 1:]
    sine2 = (vector * vector).sum(-1)
    small = sine2 < torch.finfo(rotation.dtype).eps
    sine = torch.where(small, torch.ones_like(sine2), sine2).sqrt()
    # phi = 2 atan2(|v|, w) / |v| v; near 0 the factor is 2/w (1 - |v|^2 / (3 w^2)).
    safe_w = torch.where(small, w, torch.ones_like(w))
    near = 2 / safe_w * (1 - sine2 / (3 * safe_w * safe_w))
    factor = torch.where(small, near, 2 * torch.atan2(sine, w) / sine)
    return factor[..., None] * vector


def _unit_quaternion(rotation: Tensor) -> Tensor:
    """Return (w, x, y, z) of rotation matrices, by Shepperd's choice of the largest component as pivot.

    With q q^T = Q / 4, the matrix Q is linear in R; any of its rows, divided by its norm, is the quaternion, and
    the row with the largest diagonal loses nothing.
    """
    r = rotation
    trace = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    wx, wy, wz = r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]
    xy, xz, yz = r[..., 0, 1] + r[..., 1, 0], r[..., 0, 2] + r[..., 2, 0], r[..., 1, 2] + r[..., 2, 1]
    ww, xx, yy, zz = 1 + trace, *(1 + 2 * r[..., i, i] - trace for i in range(3))
    rows = torch.stack(
        [
            torch.stack([ww, wx, wy, wz], dim=-1),
            torch.stack([wx, xx, xy, xz], dim=-1),
            torch.stack([wy, xy, yy, yz], dim=-1),
            torch.stack([wz, xz, yz, zz], dim=-1),
        ],
        dim=-2,
    )
    pivot = torch.stack([ww, xx, yy, zz], dim=-1).argmax(dim=-1)
    row = torch.take_along_dim(rows, pivot[..., None, None].expand(*pivot.shape, 1, 4), dim=-2).squeeze(-2)
    norm: Tensor = torch.linalg.vector_norm(row, dim=-1, keepdim=True)
    return row / norm


def exp(xi: Tensor) -> Tensor:
    """Turn tangent vectors into rigid motions, [..., 6] -> [..., 4, 4].

    exp(rho, phi) = [[R, V rho], [0, 1]], V = I + (1 - cos x)/x^2 [phi] + (x - sin x)/x^3 [phi]^2, x = |phi|.
    """
    rho, phi = xi[..., :3], xi[..., 3:]
    a, b, c = (k[..., None, None] for k in _coefficients((phi * phi).sum(-1)))
    cross = hat(phi)
    cross2 = cross @ cross
    eye = torch.eye(3, dtype=xi.dtype, device=xi.device)
    rotation = eye + a * cross + b * cross2
    translation = (eye + b * cross + c * cross2) @ rho[..., None]
    return _assemble(rotation, translation)


def log(motion: Tensor) -> Tensor:
    """Turn rigid motions into tangent vectors of rotation angle at most pi, [..., 4, 4] -> [..., 6].

    V^-1 = I - [phi]/2 + d [phi]^2, d = (1 - h cot h) / x^2 with x = |phi| and h = x/2.
    """
    phi = so3_log(motion[..., :3, :3])
    d = _inverse_coefficient((phi * phi).sum(-1))
    cross = hat(phi)
    eye = torch.eye(3, dtype=motion.dtype, device=motion.device)
    inverse = eye - cross / 2 + d[..., None, None] * (cross @ cross)
    return torch.cat([(inverse @ motion[..., :3, 3:]).squeeze(-1), phi], dim=-1)


def _inverse_coefficient(angle2: Tensor) -> Tensor:
    """Return (1 - h cot h) / x^2 for x^2 = `angle2`, h = x/2."""
    small, near, far2 = _split(angle2)
    series = torch.zeros_like(near)
    for coefficient in reversed(_HALF_COTANGENT):
        series = series * (near / 4) + coefficient
    half = far2.sqrt() / 2
    # h cot h as h cos h / sin h: the tangent would overflow at pi.
    closed = (1 - half * torch.cos(half) / torch.sin(half)) / far2
    return torch.where(small, series / 4, closed)


def inverse(motion: Tensor) -> Tensor:
    """Invert rigid motions, [..., 4, 4] -> [..., 4, 4]: the transposed rotation, no linear solve."""
    rotation = motion[..., :3, :3].transpose(-1, -2)
    return _assemble(rotation, -rotation @ motion[..., :3, 3:])


def _assemble(rotation: Tensor, translation: Tensor) -> Tensor:
    """Stack R [..., 3, 3] and t [..., 3, 1] into [..., 4, 4]."""
    upper = torch.cat([rotation, translation], dim=-1)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=upper.dtype, device=upper.device)
    return torch.cat([upper, last.expand(*upper.shape[:-2], 1, 4)], dim=-2)
