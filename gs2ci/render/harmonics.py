"""Direction-dependent colours: real spherical harmonics up to degree 3.

Here: the basis, and the colours that each view sees from a scene's coefficients, in the convention of 3D Gaussian
splatting files. Not here: files (`ply`), blending (backends blend colours per view).
"""

import math
from typing import Final

import torch
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.render.conventions import SIGHT_MIN
from gs2ci.render.gaussians import HARMONICS, Gaussians

DEGREE_MAX: Final = len(HARMONICS) - 1

SH_DC: Final = 1.0 / (2.0 * math.sqrt(math.pi))
"""Y_00 = 0.28209479."""

_1: Final = math.sqrt(3 / (4 * math.pi))
_2: Final = tuple(math.sqrt(n / math.pi) for n in (15 / 4, 5 / 16, 15 / 16))
_3: Final = tuple(math.sqrt(n / math.pi) for n in (35 / 32, 105 / 4, 21 / 32, 7 / 16, 105 / 16))


def coefficients(degree: int) -> int:
    """Return the number of harmonics above the constant one up to a degree.

    Raises:
        InputError: The degree is not 0 to 3.
    """
    if not 0 <= degree <= DEGREE_MAX:
        raise InputError(f"spherical harmonics of degree {degree}", allowed=f"0 to {DEGREE_MAX}")
    return HARMONICS[degree]


def degree_of(scene: Gaussians) -> int:
    """Return the highest degree of a scene's harmonics; 0 if its colours do not depend on direction."""
    return 0 if scene.harmonics is None else HARMONICS.index(scene.harmonics.shape[1])


def basis(directions: Tensor) -> Tensor:
    """Evaluate the harmonics of degrees 1 to 3, [..., 3] -> [..., 15].

    Within a degree l the orders run from -l to l. The phase (-1)^m of Condon and Shortley is included, as in Kerbl et
    al. (2023) and the files of their program. Orthonormal over the sphere: Sloan, "Stupid Spherical Harmonics Tricks"
    (2008), appendix A2.

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


def colours_seen(scene: Gaussians, world_to_camera: Tensor, times: Tensor | None = None) -> Tensor:
    """Return each Gaussian's colour from each camera, [V, G, 3], at least 0: light is never negative.

    Differentiable in colours and harmonics and, through the viewing direction, in the centres and the poses. If light
    would be negative, all gradients are zero, as in Kerbl et al. (2023).

    Args:
        scene: Its colours are the constant part, 0.5 + SH_DC f_dc.
        world_to_camera: Poses, [V, 4, 4].
        times: When each pose was taken, [V], for scenes that move.

    Raises:
        InputError: The scene has no harmonics.
    """
    if scene.harmonics is None:
        raise InputError("a scene without harmonics", allowed="one whose colours change with the direction of sight")
    dtype = scene.means.dtype
    rotation, translation = world_to_camera[:, :3, :3].to(dtype), world_to_camera[:, :3, 3].to(dtype)
    centres = -(rotation.transpose(1, 2) @ translation[..., None])[..., 0]
    means = scene.means if times is None else scene.means_at(times)
    directions = torch.nn.functional.normalize(means - centres[:, None], dim=-1, eps=SIGHT_MIN)
    shape = basis(directions)[..., : scene.harmonics.shape[1]]
    seen: Tensor = scene.colours + torch.einsum("vgk,gkc->vgc", shape, scene.harmonics.to(dtype))
    return seen.clamp(min=0.0)


def colours_from(scene: Gaussians, world_to_camera: Tensor) -> Tensor:
    """Return the colours, [G, 3], that one camera sees, [4, 4]; without harmonics, the scene's own."""
    return scene.colours if scene.harmonics is None else colours_seen(scene, world_to_camera[None])[0]


def turned(harmonics: Tensor, rotation: Tensor) -> Tensor:
    """Return the coefficients of a rotated scene, [G, K, 3]: seen from rotated positions it looks the same.

    A rotation maps the harmonics of each degree to combinations of themselves. The matrix is solved for from the basis
    in more directions than there are orders, which is exact.

    Args:
        harmonics: [G, K, 3].
        rotation: new_from_old, [3, 3].
    """
    directions = spread_directions(64).to(torch.float64)
    before, after = basis(directions), basis(directions @ rotation.to(torch.float64).T)
    found = []
    for degree in range(1, HARMONICS.index(harmonics.shape[1]) + 1):
        own = slice(HARMONICS[degree - 1], HARMONICS[degree])
        # A coefficient vector c shows basis(d) c in the old direction d, and basis(R d) c' in the new one.
        matrix = torch.linalg.lstsq(after[:, own], before[:, own]).solution
        found.append(torch.einsum("kj,gjc->gkc", matrix, harmonics[:, own].to(torch.float64)))
    return torch.cat(found, dim=1).to(harmonics.dtype)


def spread_directions(count: int) -> Tensor:
    """Return unit vectors spread evenly over the sphere (a spiral of golden angles), [count, 3]."""
    step = torch.arange(count, dtype=torch.float64) + 0.5
    z, angle = 1 - 2 * step / count, math.pi * (1 + math.sqrt(5)) * step
    ring = (1 - z * z).sqrt()
    return torch.stack([ring * angle.cos(), ring * angle.sin(), z], dim=1)
