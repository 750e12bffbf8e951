"""The depth at which a pixel's light is stopped along its ray: the definition of depth.

Here: the contents of a depth map, its constants, and the profile of a Gaussian along a ray. Not here: its computation
(`Backend.depths`, by the definition in `tests/render/reference.py` and the kernel in `cpu/stopping.py`).

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
