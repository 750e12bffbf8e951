"""The depth at which a pixel's light is stopped along its ray: the definition of depth.

Here: the contents of a depth map, its constants, the profile of a Gaussian along a ray, and what each Gaussian says of
depth in each view, for all renderers. Not here: what follows for pixels (`Backend.depths`, by the definition in
`tests/render/reference.py` and kernels in `cpu/stopping.py` and `warp/stopping.py`).

Gaussian i stops the share w_i = alpha_i T_i of a pixel's light, as in blending. It does so not at the depth of its
centre but where the Gaussian is densest along the ray. With the affine camera of the image model, depth z and screen
position are jointly normal, so that at an offset d from the centre on screen, with Cov the dilated covariance on screen
and c the covariance of z with the screen position,

    delta = c^T Cov^-1 d,   s^2 = var(z) - c^T Cov^-1 c,   1/z_i = (1 - delta / z_centre) / z_centre.

Inverse depth, not depth, is assumed to be affine on screen, as it is for a plane: a flat Gaussian is then exactly its
plane (Zhang et al. 2024, RaDe-GS, use depth itself). About z_i the light is stopped with the parabolic profile
(Epanechnikov) of variance s^2; it is as good as the normal one, which is unbounded and needs an error function.
With F(z) the share of the pixel's stopped light that is stopped before z, depth is the nearest z at which F reaches one
half. A mean of depths, by contrast, would lie in the empty space between two surfaces that share a pixel.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from gs2ci.render.conventions import DILATION_PX2, FRUSTUM_MARGIN, LOG_SCALE_MAX, NEAR
from gs2ci.render.gaussians import rotation_matrices

DEPTH_QUANTILE: Final = 0.5
"""The share of a pixel's stopped light that has been stopped at its depth."""

SPREAD_QUANTILES: Final = (0.16, 0.84)
"""The range between them corresponds to one standard deviation to either side of a normal distribution."""

OPAQUE: Final = 0.5
"""A pixel shows a surface if at least this share of its light is stopped."""

NEARBY: Final = 0.05
"""Light stopped within this share of the depth, either way, counts as stopped there."""

RATIO_MAX: Final = 4.0
"""Bound on the depth at which a Gaussian stops light, in multiples of its centre's depth, for rays that miss its
plane."""

PROFILE_REACH: Final = 5.0**0.5
"""Half the length of the profile, in its standard deviations: a parabola's."""

PROFILE_SIGMA_RANGE: Final = (1e-6, 0.4)
"""Bounds of a profile's standard deviation, as shares of its depth: it is not a step, and stays in front of the
camera."""

QUANTILE_SLACK: Final = 1e-6
"""A share counts as reached if no more than this is missing: if a surface stops exactly half, depth is that of this
surface, and not, by the rounding of a sum, that of the next one."""

RESOLUTION: Final = 1e-7
"""Relative accuracy of depth."""


@dataclass(frozen=True)
class StoppedLight:
    """The depths at which the light of every pixel is stopped; [V, H, W] each.

    Args:
        depth: Along the optical axis, scene units: half of the stopped light is stopped before it. 0 if no light is
            stopped.
        spread: Half the difference of the inverse depths at `SPREAD_QUANTILES`, as a share of the inverse depth:
            0 for one thin surface, and if no light is stopped.
        stopped: Share of the light that is stopped at all, 0 to 1.
        nearby: Share of the light that is stopped within `NEARBY` of the depth, at most `stopped`: 1 for one opaque
            surface, less in fog, at an edge between near and far, and where light passes.
    """

    depth: Tensor
    spread: Tensor
    stopped: Tensor
    nearby: Tensor

    def surface(self) -> Tensor:
        """Return the depth, [V, H, W], 0 at pixels where less than `OPAQUE` of the light is stopped."""
        return torch.where(self.stopped >= OPAQUE, self.depth, 0.0)


def depth_fields(
    means: Tensor,
    log_scales: Tensor,
    quaternions: Tensor,
    world_to_camera: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
) -> Tensor:
    """Find what each Gaussian says of depth in each view, in float64 on the way.

    Args:
        means: [G, 3], or in each view [V, G, 3].
        log_scales: [G, 3].
        quaternions: Of any norm, (w, x, y, z), [G, 4].
        world_to_camera: [V, 4, 4].
        intrinsics: [3, 3].
        size: Height and width of the frame, px.

    Returns:
        Depth of the centre, its change per px along x and y as shares of that, and the standard deviation of depth
        along a ray, scene units, [V, G, 4] float32.
    """
    means, log_scales, quaternions, world_to_camera = (
        one.detach().double() for one in (means, log_scales, quaternions, world_to_camera)
    )
    camera = intrinsics.detach().to(means)
    focal, centre, extent = camera.diagonal()[:2], camera[:2, 2], camera.new_tensor(size[::-1])
    low, high = (-centre / focal - FRUSTUM_MARGIN * extent / focal, (extent - centre + FRUSTUM_MARGIN * extent) / focal)
    factor = rotation_matrices(quaternions) * log_scales.clamp(max=LOG_SCALE_MAX).exp()[:, None]
    columns = factor.permute(1, 2, 0).reshape(3, -1)
    fields = means.new_empty(len(world_to_camera), 4, len(log_scales), dtype=torch.float32)
    for view, pose in enumerate(world_to_camera):
        points = pose[:3, :3] @ (means if means.ndim == 2 else means[view]).T + pose[:3, 3:]
        depth = points[2].clamp(min=NEAR)
        axes = (pose[:3, :3] @ columns).view(3, 3, -1)
        along = axes[2]
        x, y = ((axes[k] - (points[k] / depth).clamp(low[k], high[k]) * along) * (focal[k] / depth) for k in (0, 1))
        # Covariances of the place on screen, px, with itself and with depth.
        xx, xy, yy = (x * x).sum(0) + DILATION_PX2, (x * y).sum(0), (y * y).sum(0) + DILATION_PX2
        xz, yz = (x * along).sum(0), (y * along).sum(0)
        determinant = xx * yy - xy * xy
        by_x, by_y = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        sigma = ((along * along).sum(0) - by_x * xz - by_y * yz).clamp(min=0).sqrt()
        fields[view] = torch.stack([depth, by_x / depth, by_y / depth, sigma])
    return fields.mT.contiguous()
