"""Steps of positions in the coordinates that views see: the place in a reference view, and inverse depth.

Views from a short path determine where a Gaussian is across the line of sight far better than its depth: if the path is
5 % of the depth, a step along the line of sight changes the views a twentieth as much as one across it. Adam's steps
have the same length in every coordinate, so in scene coordinates either depth hardly moves within a schedule, or places
jitter. In (x/z, y/z, 1/z) of a reference view (the inverse-depth parametrisation; Civera, Davison and Montiel 2008)
each coordinate has a step of its own, stated in pixels. A Gaussian that moves along its line of sight keeps its size in
the picture.

Here: the coordinates, the settings of the steps, and Adam in them. Not here: the other parameters (`gaussians.py`),
depths of whole regions (`surfaces/depth_field.py`).
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.kernels import f32_2, f64, f64_2, kernel
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.distances import MOST_GROWTH, most_growth, seen_from, turned
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.render.conventions import NEAR

Share = Annotated[float, Field(gt=0, le=1)]


@dataclass(frozen=True)
class ViewSteps(Bounded):
    """Adam's steps of positions, at the start of a schedule of `NATURAL_ITERATIONS`.

    Args:
        across_px: Across the line of sight, in pixels of the reference view.
        parallax_px: Along it, in pixels of parallax along the whole path.
        across_final_share: Share of the first that is left at the end of the schedule; exponential in between.
        parallax_final_share: Likewise of the second.
    """

    across_px: Positive = 0.2
    parallax_px: Positive = 0.035
    across_final_share: Share = 0.2
    parallax_final_share: Share = 0.1

    def times(self, stride: float) -> "ViewSteps":
        """Return steps that are longer by a factor."""
        return replace(self, across_px=self.across_px * stride, parallax_px=self.parallax_px * stride)


@dataclass(frozen=True)
class ReferenceView:
    """The view in whose coordinates positions step.

    Args:
        pose: world_to_camera, [4, 4].
        focal_px: Its focal length, px.
        path_length: Diameter of the camera path, that of one exposure, in scene units.
    """

    pose: F64
    focal_px: float
    path_length: float

    def units(self, steps: ViewSteps, progress: float) -> tuple[float, float]:
        """Return the steps in x/z or y/z, and in 1/z, after a share of the schedule, in [0, 1]."""
        across_px = steps.across_px * steps.across_final_share**progress
        parallax_px = steps.parallax_px * steps.parallax_final_share**progress
        return across_px / self.focal_px, parallax_px / (self.focal_px * self.path_length)


class ViewAdam:
    """Adam for means and, along the line of sight, for sizes with them.

    Args:
        view: Gives the coordinates.
        steps: Their step sizes.
        moments: Of the gradients in these coordinates.
    """

    def __init__(self, view: ReferenceView, steps: ViewSteps, moments: Adam) -> None:
        self._view, self._steps, self._moments = view, steps, moments

    def step(self, means: Tensor, log_scales: Tensor, progress: float, damping: float) -> None:
        """Move means against the gradient, in place, and change sizes as distances change.

        Args:
            means: [G, 3], with its gradient; without one nothing moves.
            log_scales: [G, 3]; its gradient may be missing.
            progress: Share of the schedule that is done, in [0, 1].
            damping: Factor on the steps.
        """
        if means.grad is None:
            return
        places, sizes = means.detach(), log_scales.detach()
        by_sizes = torch.zeros_like(sizes) if log_scales.grad is None else log_scales.grad.contiguous()
        gradient, moved = torch.empty_like(places), torch.zeros_like(places)
        call(gradient_in_view, places, means.grad.contiguous(), by_sizes, self._view.pose, NEAR, gradient)
        self._moments.move(moved, gradient, damping)
        call(move_in_view, places, sizes, moved, self._view.pose, NEAR, *self._view.units(self._steps, progress))


@kernel(f32_2, f32_2, f32_2, f64_2, f64, f32_2)
def gradient_in_view(means, by_means, by_log_scales, pose, near, gradient):
    """Store the gradient by (x/z, y/z, 1/z), sizes in the picture being fixed, given those by means and log sizes.

    Behind the view, or nearer than `near`, the coordinates are those of the camera instead, x, y, z.

    Args:
        means: [G, 3].
        by_means: Likewise.
        by_log_scales: Likewise.
        pose: Of the view, [4, 4].
        near: The least depth.
        gradient: Written: [G, 3].
    """
    for g in range(len(means)):
        x, y, z = seen_from(means, pose, g)
        dx, dy, dz = turned(by_means, pose, g)
        if z <= near:
            gradient[g, 0], gradient[g, 1], gradient[g, 2] = dx, dy, dz
            continue
        sizes = by_log_scales[g, 0] + by_log_scales[g, 1] + by_log_scales[g, 2]
        gradient[g, 0], gradient[g, 1] = z * dx, z * dy
        gradient[g, 2] = -z * (x * dx + y * dy + z * dz + sizes)


@kernel(f32_2, f32_2, f32_2, f64_2, f64, f64, f64)
def move_in_view(means, log_scales, steps, pose, near, across, inverse):
    """Add steps to the coordinates of `gradient_in_view`, in place, within the bounds of `distances`.

    Args:
        means: [G, 3].
        log_scales: [G, 3].
        steps: In units of the next two, [G, 3].
        pose: Of the view, [4, 4].
        near: The least depth.
        across: Unit of x/z and y/z, and of camera coordinates behind the view.
        inverse: Unit of 1/z.
    """
    for g in range(len(means)):
        x, y, z = seen_from(means, pose, g)
        if z <= near:
            moved = (across * steps[g, 0], across * steps[g, 1], across * steps[g, 2])
        else:
            # z' = z / (1 + z s): differences, so that small steps are not lost in rounding.
            most = most_growth(z)
            change = min(max(z * inverse * steps[g, 2], -most / (1 + most)), MOST_GROWTH)
            farther = 1 / (1 + change)
            growth = farther - 1
            moved = (
                growth * x + z * farther * across * steps[g, 0],
                growth * y + z * farther * across * steps[g, 1],
                growth * z,
            )
            larger = np.log(farther)
            for j in range(3):
                log_scales[g, j] += larger
        for j in range(3):
            means[g, j] += moved[0] * pose[0, j] + moved[1] * pose[1, j] + moved[2] * pose[2, j]
