"""Colours that change with the direction they are seen from: real spherical harmonics up to degree 3.

Here: the basis and the step from coefficients to the colours that one view sees, in the convention of 3D Gaussian
splatting files. Not here: files (`ply`), blending (backends take colours per view).
"""

import math
from typing import Final

import torch
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians, check_tensor

DEGREE_MAX: Final = 3

SH_DC: Final = 1.0 / (2.0 * math.sqrt(math.pi))
"""Y_00 = 0.28209479."""

_1: Final = math.sqrt(3 / (4 * math.pi))
_2: Final = tuple(math.sqrt(n / math.pi) for n in (15 / 4, 5 / 16, 15 / 16))
_3: Final = tuple(math.sqrt(n / math.pi) for n in (35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16))


def coefficients(degree: int) -> int:
    """Return how many harmonics above the constant one there are up to a degree.

    Raises:
        InputError: The degree is not 0 to 3.
    """
    if not 0 <= degree <= DEGREE_MAX:
        raise InputError(f"spherical harmonics of degree {degree}", allowed=f"0 to {DEGREE_MAX}")
    return (degree + 1) ** 2 - 1


def basis(directions: Tensor) -> Tensor:
    """Evaluate the harmonics of degrees 1 to 3, [..., 3] -> [..., 15].

    Within a degree l the orders run from -l to l. The phase (-1)^m of Condon and Shortley is in, as Kerbl et al.
    (2023) and the files of their program have it. Orthonormal over the sphere: Sloan, "Stupid Spherical Harmonics
    Tricks" (2008), appendix A2.

    Args:
        directions: Unit vectors, from the camera to what it sees.
    """
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            *(-_1 * y, _1 * z, -_1 * x),
            *(_2[0] * x * y, -_2[0] * y * z, _2[1] * (2 * zz - xx - yy), -_2[0] * x * z, _2[2] * (xx - yy)),
            -_3[0] * y * (3 * xx - yy),
            _3[1] * x * y * z,
            -_3[2] * y * (4 * zz - xx - yy),
            _3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            -_3[2] * x * (4 * zz - xx - yy),
            _3[4] * z * (xx - yy),
            -_3[0] * x * (xx - 3 * yy),
        ],
        dim=-1,
    )


def colours_seen(gaussians: Gaussians, harmonics: Tensor, world_to_camera: Tensor) -> Tensor:
    """Return each Gaussian's colour from each camera, [V, G, 3], at least 0: light is never negative.

    Args:
        gaussians: Their colours are the constant part, 0.5 + SH_DC f_dc.
        harmonics: Coefficients f_rest above the constant, [G, K, 3], K = 3, 8 or 15; the last axis is RGB.
        world_to_camera: Poses, [V, 4, 4].

    Raises:
        InputError: Shapes disagree or a number is not finite.
    """
    check_harmonics(harmonics, len(gaussians))
    rotation, translation = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]
    centres = -(rotation.transpose(1, 2) @ translation[..., None])[..., 0]
    directions = torch.nn.functional.normalize(gaussians.means[None] - centres[:, None].to(gaussians.means), dim=-1)
    shape = basis(directions)[..., : harmonics.shape[1]]
    seen: Tensor = gaussians.colours + torch.einsum("vgk,gkc->vgc", shape, harmonics.to(shape))
    return seen.clamp(min=0.0)


def check_harmonics(harmonics: Tensor, count: int) -> None:
    """Accept the coefficients of `count` Gaussians.

    Raises:
        InputError: Not [count, K, 3] with K = 3, 8 or 15, or not finite.
    """
    allowed = [coefficients(degree) for degree in range(1, DEGREE_MAX + 1)]
    columns = harmonics.shape[1] if harmonics.ndim == 3 else 0
    if columns not in allowed:
        raise InputError(
            f"spherical harmonics of shape {list(harmonics.shape)}",
            allowed=f"[{count}, one of {', '.join(map(str, allowed))}, 3]",
        )
    check_tensor("spherical harmonics", harmonics, (count, columns, 3))
