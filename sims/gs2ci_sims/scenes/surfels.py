"""Surfaces as Gaussians: flat discs that tile a surface without cracks, from its points and tangents.

Here: pure numpy geometry, from a depth map or from two tangent vectors per point to Gaussian parameters. Not here: the
source of the depth (`rgbd`, `planes`), rendering.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.lens import pixel_centres, rays_of
from gs2ci.render.gaussians import Gaussians

# Standard deviation of a disc in units of the sample spacing: at 0.6 the sum of a unit grid of Gaussians is even
# to 0.4 % (Poisson summation: 4 exp(-2 π² 0.6²)). Narrower discs transmit light between them, wider ones blur. In an
# infinitely magnified view 5 % pass at the middle of four discs; with pixels as wide as the samples, less than 1 %.
SPREAD: Final = 0.6
# Discs are this much thinner than they are wide: a surface, yet a covariance that inverts well in float32.
THINNESS: Final = 0.05
# A surface seen at a grazing angle is stretched at most this many times along the line of sight.
MAX_STRETCH: Final = 8.0
OPACITY: Final = 0.99
# Axes are computed for so many discs at once: their intermediate arrays are several times as large as the result.
_AT_ONCE: Final = 2**18


@dataclass(frozen=True)
class Surfels:
    """Flat Gaussians in scene units.

    Args:
        means: Centres, [n, 3].
        scales: Standard deviations along the principal axes, [n, 3]; the last is the thickness.
        quaternions: Principal axes as w, x, y, z, [n, 4].
        opacities: Peak opacities, [n], in (0, 1).
        radiances: Linear radiance, [n, 3]; 1 is white.
    """

    means: F64
    scales: F64
    quaternions: F64
    opacities: F64
    radiances: F64

    def __len__(self) -> int:
        return len(self.means)


def join(parts: list[Surfels]) -> Surfels:
    """Concatenate several sets of surfels."""
    columns = ("means", "scales", "quaternions", "opacities", "radiances")
    return Surfels(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


def from_tangents(points: F64, along_u: F64, along_v: F64, radiances: F64) -> Surfels:
    """Place one disc on each point, which spans its two tangents.

    Args:
        points: [n, 3].
        along_u: The step to the next sample along u, [n, 3].
        along_v: The same along v, not parallel to `along_u`.
        radiances: [n, 3].

    The covariance is SPREAD² (u uᵀ + v vᵀ): on the sample grid it is round, whatever the surface's tilt. Its axes
    come in closed form from the 2 × 2 Gram matrix of u and v (a Jacobi rotation).

    Raises:
        InputError: Two tangents of a point are parallel or vanish.
    """
    scales, quaternions = np.empty((len(points), 3)), np.empty((len(points), 4))
    for first in range(0, len(points), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        scales[part], quaternions[part] = _discs(along_u[part], along_v[part])
    return Surfels(points, scales, quaternions, np.full(len(points), OPACITY), radiances)


def _discs(along_u: F64, along_v: F64) -> tuple[F64, F64]:
    """Return scales, [n, 3], and quaternions, [n, 4], of the discs that span two tangents, n >= 1."""
    uu, vv = np.sum(along_u**2, 1), np.sum(along_v**2, 1)
    angle = 0.5 * np.arctan2(2 * np.sum(along_u * along_v, 1), uu - vv)
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    first, second = cos * along_u + sin * along_v, cos * along_v - sin * along_u
    lengths = np.stack([np.linalg.norm(first, axis=1), np.linalg.norm(second, axis=1)], 1)
    if lengths.min() <= 1e-9 * lengths.max():
        raise InputError(
            "two tangents of a surface point are parallel or zero",
            allowed="tangents that span a plane",
            remedy="give the patch two different, non-zero edges",
        )
    first, second = first / lengths[:, :1], second / lengths[:, 1:]
    axes = np.stack([first, second, np.cross(first, second)], axis=2)
    thickness = THINNESS * lengths.min(1, keepdims=True)
    xyzw = Rotation.from_matrix(axes).as_quat()
    return SPREAD * np.concatenate([lengths, thickness], 1), np.roll(xyzw, 1, axis=1)


def from_inverse_depth(inverse_depth: F64, radiance: F64, present: Bool, intrinsics: F64, jump: float) -> Surfels:
    """Place one disc on each pixel of an inverse-depth map.

    Args:
        inverse_depth: [H, W], 1 / scene units, positive where `present`.
        radiance: [H, W, 3].
        present: Which pixels are part of this surface, [H, W].
        intrinsics: Camera of the map, [3, 3]; pixel centres at +0.5.
        jump: Neighbours whose inverse depths differ by more are different surfaces.
    """
    rows, columns = np.nonzero(present)
    rays = rays_of(pixel_centres(present.shape)[rows, columns], intrinsics)
    depth = 1.0 / inverse_depth[rows, columns]
    tangents = []
    for axis, focal in ((1, intrinsics[0, 0]), (0, intrinsics[1, 1])):
        slope = surface_slope(inverse_depth, present, axis, jump)[rows, columns]
        step = depth / focal  # one pixel across the line of sight
        depth_step = np.clip(-(depth**2) * slope, -MAX_STRETCH * step, MAX_STRETCH * step)
        tangent = depth_step[:, None] * rays
        tangent[:, 1 - axis] += step
        tangents.append(tangent)
    return from_tangents(depth[:, None] * rays, tangents[0], tangents[1], radiance[rows, columns])


def surface_slope(values: F64, present: Bool, axis: int, jump: float) -> F64:
    """Differentiate along `axis` without stepping over an edge of the surface, [H, W] per pixel.

    It is the mean of the one-sided differences that stay on the surface (both pixels present, no jump), or 0 if neither
    does.
    """
    ahead = np.diff(values, axis=axis)
    cut = [slice(None), slice(None)]
    cut[axis] = slice(1, None)
    other = [slice(None), slice(None)]
    other[axis] = slice(None, -1)
    same = present[tuple(cut)] & present[tuple(other)] & (np.abs(ahead) <= jump)
    total, count = np.zeros(values.shape), np.zeros(values.shape)
    for part in (tuple(cut), tuple(other)):
        total[part] += np.where(same, ahead, 0.0)
        count[part] += same
    return total / np.maximum(count, 1)


def gaussians_from_surfels(surfels: Surfels) -> Gaussians:
    """Turn surfels into the renderer's parameters: log scales, opacity logits."""
    opacity_logits = np.log(surfels.opacities) - np.log1p(-surfels.opacities)
    return Gaussians(
        *(
            torch.tensor(column, dtype=torch.float32)
            for column in (
                surfels.means,
                np.log(surfels.scales),
                surfels.quaternions,
                opacity_logits,
                surfels.radiances,
            )
        )
    )


def gaussians_from_parts(parts: Iterable[Surfels]) -> Gaussians:
    """Turn several sets of surfels into one scene, one after the other: a set needs twice the memory of its Gaussians.

    `gaussians_from_surfels` of all sets together gives the same.
    """
    scenes = [gaussians_from_surfels(part).parameters() for part in parts]
    return Gaussians(**{name: torch.cat([scene[name] for scene in scenes]) for name in scenes[0]})
