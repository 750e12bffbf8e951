"""Camera poses as corrections in se(3) on their initial estimates: Tᵢ = exp(ξᵢ) Tᵢ⁽⁰⁾ (paper, section III-C).

Here: the parameters, their optimiser and its schedule, and the length that step sizes are measured in. Not here: the
initial poses (`reconstruct.geometry`). For `gs2ci.reconstruct.fit`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.render import se3


@dataclass(frozen=True)
class PoseSettings:
    """How poses are refined.

    Args:
        refine: Whether they are refined at all.
        every: Gradients are accumulated over this many iterations before a step. The paper takes 25; on schedules
            of a few hundred iterations 5 gave 0.5 dB more.
        rate: Initial step size of Adam, in radians and in units of the median depth.
        final_rate: Step size at the end; exponential in between.
    """

    refine: bool = True
    every: int = 5
    rate: float = 3e-3
    final_rate: float = 6e-6


def path_extent(world_to_camera: F64) -> float:
    """Return the diameter of a camera path, [N, 4, 4], with a floor for a camera that hardly moves.

    Depths are about one (`geometry` normalises them), so the floor is 2 % of the depth: without it nothing could
    move along a ray when the path is short.
    """
    centres = camera_centres(world_to_camera)
    return max(float(np.linalg.norm(centres.max(axis=0) - centres.min(axis=0))), 0.02)


class PoseCorrections:
    """One twist per view, [N, 6] (translation first), optimised by Adam on accumulated gradients."""

    def __init__(self, world_to_camera: F64, settings: PoseSettings) -> None:
        self._initial = torch.from_numpy(world_to_camera).float()
        self._settings = settings
        self._twists = torch.zeros(len(world_to_camera), 6, requires_grad=settings.refine)
        # eps as for the Gaussians: gradients of a mean over pixels are far below Adam's default 1e-8.
        self._adam = torch.optim.Adam([self._twists], lr=settings.rate, eps=1e-15) if settings.refine else None
        self._accumulated = 0

    def world_to_camera(self) -> Tensor:
        """Return the corrected poses, [N, 4, 4] float32, differentiable in the twists."""
        if self._adam is None:
            return self._initial
        return se3.exp(self._twists) @ self._initial

    def step(self, progress: float) -> None:
        """Take note of one more accumulated gradient, and step when it is time.

        Args:
            progress: Share of the schedule that is done, in [0, 1]: sets the step size.
        """
        if self._adam is None or self._twists.grad is None:
            return
        self._accumulated += 1
        if self._accumulated < self._settings.every:
            return
        self._twists.grad /= self._accumulated
        rates = self._settings
        self._adam.param_groups[0]["lr"] = rates.rate * (rates.final_rate / rates.rate) ** progress
        self._adam.step()
        self.forget_gradient()

    def forget_gradient(self) -> None:
        """Drop what has been accumulated."""
        self._twists.grad = None
        self._accumulated = 0

    def gradient_is_finite(self) -> bool:
        """Tell whether the accumulated gradient is free of NaN and infinities."""
        return self._twists.grad is None or bool(torch.isfinite(self._twists.grad).all())

    def snapshot(self) -> Tensor:
        """Return a copy of the twists, [N, 6]."""
        return self._twists.detach().clone()

    def restore(self, twists: Tensor) -> None:
        """Go back to a snapshot, [N, 6]; the optimiser forgets its momentum, which led away from it."""
        with torch.no_grad():
            self._twists.copy_(twists)
        self.forget_gradient()
        if self._adam is not None:
            self._adam.state.clear()
