"""Where along its ray a pixel's light is stopped: the definition of depth.

Here: what a depth map holds, its constants, and the profile of a Gaussian along a ray. Not here: who computes it
(`Backend.depths`, by the definition in `reference.py` and the kernel in `cpu/stopping.py`).

A Gaussian i of a pixel stops the share w_i = alpha_i T_i of its light, as blending has it. Of this, the pixel's ray
meets the Gaussian not at the depth of its centre but where the Gaussian is densest along the ray. With the affine
camera of the image model, depth z and screen position are jointly normal, so that at an offset d from the centre on
screen, with Cov the dilated covariance on screen and c the covariance of z with the screen position,

    delta = c^T Cov^-1 d,   s^2 = var(z) - c^T Cov^-1 c,   1/z_i = (1 - delta / z_centre) / z_centre.

Inverse depth instead of depth is taken as affine on screen, as it is for a plane: a flat Gaussian then is the plane
that it lies in (Zhang et al. 2024, RaDe-GS, take depth itself). About z_i the light is stopped with the parabolic
profile (Epanechnikov) of variance s^2; it is as good as the normal one, which has no end and costs an error function.
With F(z) the share of the pixel's stopped light that is stopped before z, depth is the nearest z where F reaches one
half. A mean of depths, by contrast, lies in the empty space between two surfaces that share a pixel.
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

DEPTH_QUANTILE: Final = 0.5
"""The share of a pixel's stopped light that has been stopped at its depth."""

SPREAD_QUANTILES: Final = (0.16, 0.84)
"""Between these lies what a standard deviation either way of a normal distribution holds."""

OPAQUE: Final = 0.5
"""Something is there where at least this share of the light is stopped."""

NEARBY: Final = 0.05
"""Light stopped within this share of the depth, either way, counts as stopped there."""

RATIO_MAX: Final = 4.0
"""No Gaussian stops light farther away than this many times its centre's depth, where its plane meets a ray nowhere."""

PROFILE_REACH: Final = 5.0**0.5
"""Half the length of the profile, in its standard deviations: a parabola's."""

PROFILE_SIGMA_RANGE: Final = (1e-6, 0.4)
"""Bounds of a profile's standard deviation, as shares of its depth: it stays before the camera, and no step."""

QUANTILE_SLACK: Final = 1e-6
"""A share is reached if no more than this is missing: where a surface stops exactly half, depth is that surface's,
and not, by the rounding of a sum, that of the next one."""

RESOLUTION: Final = 1e-7
"""Depth is found to this share of itself."""


@dataclass(frozen=True)
class StoppedLight:
    """Where the light of every pixel is stopped; [V, H, W] each.

    Args:
        depth: Along the optical axis, scene units: half of the stopped light has been stopped there. 0 where no
            light is stopped.
        spread: Half the difference of the inverse depths at `SPREAD_QUANTILES`, as a share of the inverse depth:
            0 for one thin surface. 0 where no light is stopped.
        stopped: Share of the light that is stopped at all, 0 to 1.
        nearby: Share of the light that is stopped within `NEARBY` of the depth, at most `stopped`: 1 for one opaque
            surface, less in fog, at an edge between near and far, and where light passes.
    """

    depth: Tensor
    spread: Tensor
    stopped: Tensor
    nearby: Tensor

    def surface(self) -> Tensor:
        """Return the depth, [V, H, W], 0 where less than `OPAQUE` of the light is stopped."""
        return torch.where(self.stopped >= OPAQUE, self.depth, 0.0)
