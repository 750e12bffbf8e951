"""Depths of whole regions as parameters of their own, moved by the measurement alone.

Surfaces are sought in views that a decode has put its residual back into, and those hide some of the parallax: what a
decode cannot tell apart it shows at one place in all views, as if it were farther away. The term that draws light to
these surfaces holds the scene there, and each Gaussian by itself hardly feels what moving all of a region would gain.
So a smooth field, given at the knots of a grid over the reference view and over inverse depth, is added to the inverse
depths of all Gaussians, and of the surfaces with them. Its gradient is the measurement's.

Here: the field and its steps. Not here: the loops over Gaussians and maps (`depth_field_kernels.py`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.depth_field_kernels import gather_gradient, move_gaussians, move_map
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians

# Of inverse depths, between which the knots are.
_QUANTILES = (0.02, 0.98)
# Of a distance, as a share of itself, in one step.
_MOST_GROWTH = 0.25
# Of Adam's moments, as for everything else in a fit.
_DECAY = 0.9
_SQUARE_DECAY = 0.999


@dataclass(frozen=True)
class DepthFieldSettings:
    """How the field moves.

    Args:
        every: Iterations between steps.
        across: Knots across the picture.
        down: And down.
        deep: And over inverse depth.
        rate: Of a step at the start of the schedule, in units of inverse depth, whose median is about 1.
        final_rate: At its end; exponential in between.
    """

    every: int = 2
    across: int = 6
    down: int = 5
    deep: int = 4
    rate: float = 4e-3
    final_rate: float = 4e-4

    def check(self) -> "DepthFieldSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: A rate that is not a number above 0, a count below 1, or fewer than two knots.
        """
        rates = 0 < self.rate < np.inf and 0 < self.final_rate < np.inf
        knots = min(self.across, self.down, self.deep)
        if not (rates and self.every >= 1 and knots > 1):
            raise InputError(
                f"depth field settings {self}", allowed="rates above 0, every at least 1, 2 knots or more each way"
            )
        return self


@dataclass(frozen=True)
class FieldStep:
    """What is added to inverse depths in one step.

    Args:
        pose: Of the reference view, [4, 4].
        low: The first knots' u, v and 1/z there, [3].
        between: What is between knots, [3].
        values: At the knots, [A, B, C].
    """

    pose: F64
    low: F64
    between: F64
    values: F64

    def of_scene(self, scene: Gaussians) -> None:
        """Move Gaussians, in place."""
        moved = (scene.means.detach().numpy(), scene.log_scales.detach().numpy())
        move_gaussians(*moved, self.pose, NEAR, self.low, self.between, self.values, _MOST_GROWTH)

    def of_map(self, inverse_depth: F32, pixels: NDArray[np.int64], rays: F32, world_to_camera: F64) -> None:
        """Move some pixels of a view's map, [H, W], in place.

        Args:
            inverse_depth: [H, W].
            pixels: Which, flat indices.
            rays: Where pixels look at z = 1, [H, W, 2].
            world_to_camera: The view's pose, [4, 4].
        """
        to_reference = self.pose @ np.linalg.inv(world_to_camera)
        grid = (self.low, self.between, self.values)
        move_map(inverse_depth.reshape(-1), pixels, rays.reshape(-1, 2), to_reference, *grid)


class DepthField:
    """Steps of the field, on the gradients that the scene has at the time.

    Args:
        settings: Of the steps.
        reference: Over whose picture the field is.
        widest: Half of the picture's extent at z = 1, across and down.
    """

    def __init__(self, settings: DepthFieldSettings, reference: int, widest: tuple[float, float]) -> None:
        self._settings = settings
        self._reference = reference
        self._widest = np.array(widest)
        shape = (settings.across, settings.down, settings.deep)
        self._mean, self._square, self._turns = np.zeros(shape), np.zeros(shape), 0
        self._grid: tuple[F64, F64] | None = None

    def step(self, scene: Gaussians, world_to_camera: Tensor, progress: float, iteration: int) -> FieldStep | None:
        """Choose a step by the present gradients; taking it is up to the caller; None when it is not time for one.

        Args:
            scene: The Gaussians, with their gradients.
            world_to_camera: Poses, [N, 4, 4].
            progress: Share of the schedule that is done, in [0, 1]: sets the step size.
            iteration: How many are.
        """
        if iteration % self._settings.every or scene.means.grad is None or scene.log_scales.grad is None:
            return None
        pose = world_to_camera[self._reference].detach().double().numpy()
        low, between = self._grid = self._grid or self._over(scene, pose)
        gradient = np.empty_like(self._mean)
        gather_gradient(
            *(t.detach().numpy() for t in (scene.means, scene.means.grad, scene.log_scales.grad)),
            *(pose, NEAR, low, between, gradient),
        )
        if not np.isfinite(gradient).all():
            return None
        return FieldStep(pose, low, between, -self._rate(progress) * self._direction(gradient))

    def _rate(self, progress: float) -> float:
        rates = self._settings
        return float(rates.rate * (rates.final_rate / rates.rate) ** progress)

    def _direction(self, gradient: F64) -> F64:
        """Take a gradient into Adam's moments and return what is gone along, at most about 1 at every knot.

        The mean over the knots is added to each one's squares: where a plain area hardly tells its depth, Adam's own
        steps would be as long as anywhere.
        """
        self._turns += 1
        self._mean += (1 - _DECAY) * (gradient - self._mean)
        self._square += (1 - _SQUARE_DECAY) * (gradient**2 - self._square)
        square = self._square / (1 - _SQUARE_DECAY**self._turns)
        root = np.sqrt(square + square.mean() + np.finfo(np.float64).tiny)
        direction: F64 = self._mean / (1 - _DECAY**self._turns) / root
        return direction

    def _over(self, scene: Gaussians, pose: F64) -> tuple[F64, F64]:
        """Lay the grid over a scene: its first knot and what is between knots, [3] each."""
        depth = scene.means.detach().double().numpy() @ pose[2, :3] + pose[2, 3]
        far, near = np.quantile(1 / depth[depth > NEAR], _QUANTILES)
        low = np.array([*-self._widest, far])
        high = np.array([*self._widest, max(near, far * (1 + 1e-3))])
        return low, (high - low) / (np.array(self._mean.shape) - 1)
