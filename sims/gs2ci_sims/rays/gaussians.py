"""Ray tracing of Gaussians: the scene that a PLY file defines, without the approximations of a rasteriser.

A 3D Gaussian of opacity o, seen along a ray, has the opacity o exp(-m^2 / 2), where m is its Mahalanobis distance from
the ray: this is its largest value along the ray, and its depth is that of this point. The Gaussians of a ray are
blended front to back in the order of these depths (Moenne-Loccoz et al., 3D Gaussian Ray Tracing, ACM Trans. Graphics
43 (2024), section 4). For a Gaussian that is small compared with its distance this equals the splat of Kerbl et al.
(2023): there the projection is affine, and the 2D Gaussian of the projected covariance is the largest value along each
ray. The approximations of rasterisers are left out: the affine projection at the centre, the dilation by 0.3 px^2, the
cut below 1/255 and above 0.999, the order of the centres.

A ray goes through a point; the value of a pixel is the mean over many rays. Gaussians whose largest value lies behind
the camera are not seen. An opacity below `OPACITY_MIN`, and everything behind a transmittance below it, is left out: G
Gaussians change a pixel by at most G times that. Not here: which rays are traced, and pixels (`gs2ci_sims.exact`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import EXACT, f64_1, f64_2, f64_3, i64, i64_1, in_parts, kernel
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.rays.tiles import TILE, by_tile, ellipsoid_bounds, sphere_bounds

OPACITY_MIN: Final = 1e-10
# Beyond this squared distance even an opacity of one is below `OPACITY_MIN`.
MAHALANOBIS2_MAX: Final = -2 * np.log(OPACITY_MIN)
# Logs of standard deviations are limited to this value, so that squares are normal float64 numbers.
LOG_SCALE_LIMIT: Final = 60.0


@dataclass(frozen=True)
class _Seen:
    """Gaussians in camera axes, nearest centre first.

    Args:
        whitening: Maps camera axes to units of the Gaussian's standard deviations, [G, 3, 3].
        origin: The camera's position relative to each centre in these units, [G, 3].
        opacities: [G].
        colours: [G, 3].
        bounds: Bounds in the image, pixels, [G, 4].
    """

    whitening: F64
    origin: F64
    opacities: F64
    colours: F64
    bounds: F64


def trace_gaussians(
    gaussians: Gaussians, colours: F64, world_to_camera: F64, intrinsics: F64, size: tuple[int, int]
) -> tuple[F64, F64, F64]:
    """Trace the rays through the centres of pixels.

    Args:
        gaussians: The scene.
        colours: Colours as seen from this camera, [G, 3].
        world_to_camera: [4, 4].
        intrinsics: [3, 3].
        size: Height and width, px.

    Returns:
        Radiance [H, W, 3], coverage [H, W] (the share of light from behind that is blocked), and the mean depth by the
        blending weights, times the coverage, [H, W].
    """
    seen = _in_camera(gaussians, colours, world_to_camera, intrinsics)
    begins, items = by_tile(seen.bounds, size)
    radiance, coverage, depth = np.zeros((*size, 3)), np.zeros(size), np.zeros(size)
    of_gaussians = (seen.whitening, seen.origin, seen.opacities, seen.colours)
    camera = np.ascontiguousarray(intrinsics, np.float64)
    in_parts(_trace, len(begins) - 1, begins, items, *of_gaussians, camera, radiance, coverage, depth)
    return radiance, coverage, depth


def _in_camera(gaussians: Gaussians, colours: F64, world_to_camera: F64, intrinsics: F64) -> _Seen:
    means, log_scales, logits = (
        tensor.detach().to(torch.float64).numpy()
        for tensor in (gaussians.means, gaussians.log_scales, gaussians.opacity_logits)
    )
    rotation = world_to_camera[:3, :3]
    centres = means @ rotation.T + world_to_camera[:3, 3]
    scales = np.exp(np.clip(log_scales, -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT))
    axes = _rotations(gaussians.quaternions.detach().to(torch.float64).numpy())
    opacities = np.exp(-np.logaddexp(0.0, -logits))
    whitening = (rotation @ axes).transpose(0, 2, 1) / scales[:, :, None]
    visible = opacities > OPACITY_MIN
    reach = np.sqrt(2 * np.log(np.where(visible, opacities, 1.0) / OPACITY_MIN))
    bounds = sphere_bounds(centres, np.where(visible, reach * scales.max(axis=1, initial=0.0), 0.0), intrinsics)
    spread = (rotation @ axes) * (scales * reach[:, None])[:, None, :]
    bounds = ellipsoid_bounds(centres, spread @ spread.transpose(0, 2, 1), intrinsics, bounds)
    bounds[~visible] = [np.inf, -np.inf, np.inf, -np.inf]
    order = np.argsort(centres[:, 2], kind="stable")
    origin = -np.einsum("gij,gj->gi", whitening, centres)
    return _Seen(*(np.ascontiguousarray(part[order]) for part in (whitening, origin, opacities, colours, bounds)))


def _rotations(quaternions: F64) -> F64:
    """Convert quaternions (w, x, y, z) of any norm to rotation matrices, [G, 3, 3]; zero means no rotation."""
    norm = np.linalg.norm(quaternions, axis=1, keepdims=True)
    w, x, y, z = np.where(norm > 0, quaternions / np.where(norm > 0, norm, 1.0), [1.0, 0.0, 0.0, 0.0]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


@kernel(i64, i64, i64_1, i64_1, f64_3, f64_2, f64_1, f64_2, f64_2, f64_3, f64_2, f64_2, fastmath=EXACT)
def _trace(
    from_tile, to_tile, begins, items, whitening, origin, opacities, colours, intrinsics, radiance, coverage, depths
):
    height, width = coverage.shape
    across = -(-width // TILE)
    for tile in range(from_tile, to_tile):
        first, last = begins[tile], begins[tile + 1]
        depth = np.empty(last - first)
        alpha = np.empty(last - first)
        which = np.empty(last - first, np.int64)
        for y in range(TILE * (tile // across), min(TILE * (tile // across + 1), height)):
            for x in range(TILE * (tile % across), min(TILE * (tile % across + 1), width)):
                right = (x + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
                down = (y + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
                met = 0
                for at in range(first, last):
                    g = items[at]
                    w, o = whitening[g], origin[g]
                    d0 = w[0, 0] * right + w[0, 1] * down + w[0, 2]
                    d1 = w[1, 0] * right + w[1, 1] * down + w[1, 2]
                    d2 = w[2, 0] * right + w[2, 1] * down + w[2, 2]
                    square = d0 * d0 + d1 * d1 + d2 * d2
                    along = -(o[0] * d0 + o[1] * d1 + o[2] * d2)
                    if along <= 0:
                        continue
                    # |o x d|^2 / |d|^2: no difference of large numbers.
                    c0 = o[1] * d2 - o[2] * d1
                    c1 = o[2] * d0 - o[0] * d2
                    c2 = o[0] * d1 - o[1] * d0
                    cross = c0 * c0 + c1 * c1 + c2 * c2
                    if cross > MAHALANOBIS2_MAX * square:
                        continue
                    opacity = opacities[g] * np.exp(-0.5 * cross / square)
                    if opacity < OPACITY_MIN:
                        continue
                    where = along / square
                    place = met
                    while place > 0 and depth[place - 1] > where:
                        depth[place], alpha[place] = depth[place - 1], alpha[place - 1]
                        which[place] = which[place - 1]
                        place -= 1
                    depth[place], alpha[place], which[place] = where, opacity, g
                    met += 1
                passing = 1.0
                for k in range(met):
                    weight = passing * alpha[k]
                    for channel in range(3):
                        radiance[y, x, channel] += weight * colours[which[k], channel]
                    depths[y, x] += weight * depth[k]
                    passing *= 1.0 - alpha[k]
                    if passing < OPACITY_MIN:
                        break
                coverage[y, x] = 1.0 - passing
