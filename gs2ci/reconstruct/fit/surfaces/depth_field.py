"""Depths of whole regions as parameters of their own, moved by the measurement alone.

Surfaces are found in views to which the decoded residual was added. These views show too little parallax: detail that
the decode cannot assign to one view appears at the same place in all of them, as if it were farther away. The term that
draws light to the surfaces then keeps whole regions at a wrong depth; the gradient of a single Gaussian is too small to
move them. Therefore a smooth field, given at the knots of a grid over the reference view and over inverse depth, is
added to the inverse depths of all Gaussians and of the surfaces. Only the measurement contributes to its gradient.

Here: the field and its steps. Not here: the loops over Gaussians and maps (`kernels/depth_field_kernels.py`).
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from pydantic import Field, PositiveInt
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.cameras import relative_to
from gs2ci.core.config import Positive
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.depth_field_kernels import gather_gradient, move_gaussians, move_map
from gs2ci.reconstruct.fit.optimiser.adam import DECAY, SQUARE_DECAY, Adam
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians

# The bas-relief mode of camera path and scene, as one parameter of the fit.
#
# If a constant is added to all inverse depths and each camera is turned to undo the shift of its picture, the views
# hardly change: a camera that turns a little looks like one that travels past something a little nearer (Belhumeur,
# Kriegman and Yuille 1999; for motion, Daniilidis and Spetsakis 1997). Only perspective at the borders of the picture,
# a few tenths of a pixel, tells the two apart. Poses and Gaussians with separate steps do not follow so shallow a
# valley in a few hundred iterations, since every Gaussian would have to move with every camera. A step of this
# parameter moves all of them together.
#
# With the reference camera as the frame, X = z (u, v, 1), translations t_i of the others and e the direction across
# the image in which most of them lie, the step by beta is, to first order,
#
#     1/z  ->  1/z + beta (1 + ((u, v) . e)^2 - m / z),   camera i turns by beta (t_y, -t_x, 0), moves by beta m t_i,
#
# where the square compensates the part of a turn's shift along the path that is not constant, and the terms with the
# median depth m keep the scene's size. What it adds to inverse depths is a field over the reference view
# (`depth_field`). What remains is a shift by -beta (t . u) across the path, in px times the focal length: it is zero
# in the middle of the picture, and by it the measurement decides.


class Relief:
    """Steps along that direction by Adam, from the gradients by the field's knots and by the poses."""

    def __init__(self) -> None:
        self._adam = Adam()

    def step(
        self, by_knots: F64, by_twists: Tensor, knots: tuple[F64, ...], travel: F64, rate: float
    ) -> tuple[F64, Tensor] | None:
        """Choose a step by the present gradients; the caller applies it.

        It is what to add to inverse depths at the field's knots, [A, B, C], and the cameras' twists, applied after
        their poses, [N, 6]. None if the camera moves forward more than sideways, since then no turn looks like travel,
        and if a gradient is not finite.

        Args:
            by_knots: Gradient by what is added to inverse depth at the field's knots, [A, B, C].
            by_twists: By twists applied after the poses, translation in scene units first, [N, 6].
            knots: u, v and 1/z of the field's knots in the reference view, [A], [B] and [C].
            travel: Positions of the reference camera seen from each one, [N, 3].
            rate: The step size, in units of inverse depth.
        """
        if not np.square(travel[:, :2]).sum() > np.square(travel[:, 2]).sum():
            return None
        values, twists = direction(knots, travel)
        slope = float((by_knots * values).sum() + (by_twists.double().numpy() * twists).sum())
        if not np.isfinite(slope):
            return None
        step = torch.zeros((), dtype=torch.float64)
        self._adam.move(step, step.new_tensor(slope), rate)
        beta = float(step)
        return beta * values, torch.from_numpy(beta * twists).to(by_twists.dtype)


def direction(knots: tuple[F64, ...], travel: F64) -> tuple[F64, F64]:
    """Return the derivatives by beta of what is added to inverse depths, [A, B, C], and of the twists, [N, 6].

    Args:
        knots: See `Relief.step`; the middle one of 1/z stands for the scene's median.
        travel: See `Relief.step`.
    """
    across, down, inverse_depth = knots
    middle_depth = 1 / float(np.mean(inverse_depth[[0, -1]]))
    (along, aside), _ = np.linalg.svd(travel[:, :2], full_matrices=False)[2]
    slant = across[:, None] * along + down * aside
    values = 1 + np.square(slant)[..., None] - middle_depth * inverse_depth
    turns = np.stack([travel[:, 1], -travel[:, 0], np.zeros(len(travel))], axis=1)
    return values, np.concatenate([middle_depth * travel, turns], axis=1)


# The knots lie between these quantiles of the inverse depths.
_QUANTILES = (0.02, 0.98)


@dataclass(frozen=True)
class DepthFieldSettings(Bounded):
    """Grid and step sizes of the field.

    Args:
        every: Iterations between steps.
        across: Knots along the rows of the picture.
        down: Knots along its columns.
        deep: Knots over inverse depth.
        rate: Step size at the start of the schedule, in units of inverse depth, whose median is about 1.
        final_rate: Step size at its end; exponential in between.
        exchange: Step size at the start by which turning of the cameras is exchanged for travel, along a path that
            nobody gave (`Relief`), a fifth of it at the end; None: none is.
    """

    every: PositiveInt = 2
    across: Annotated[int, Field(ge=2)] = 6
    down: Annotated[int, Field(ge=2)] = 5
    deep: Annotated[int, Field(ge=2)] = 4
    rate: Positive = 4e-3
    final_rate: Positive = 4e-4
    exchange: Positive | None = 1.5e-2


@dataclass(frozen=True)
class FieldStep:
    """The change of inverse depths in one step.

    Args:
        pose: Pose of the reference view, [4, 4].
        low: u, v and 1/z of the first knot in this view, [3].
        between: Distances between knots, [3].
        values: Changes at the knots, [A, B, C].
        twists: The cameras' motion that goes with it, after their poses, [N, 6] (`Relief`); None: none.
    """

    pose: F64
    low: F64
    between: F64
    values: F64
    twists: Tensor | None = None

    def of_scene(self, scene: Gaussians) -> None:
        """Move Gaussians, in place."""
        moved = (scene.means.detach(), scene.log_scales.detach())
        call(move_gaussians, *moved, self.pose, NEAR, self.low, self.between, self.values)

    def of_map(self, inverse_depth: Tensor, pixels: Tensor, rays: Tensor, world_to_camera: F64) -> None:
        """Move the given pixels of a view's map, [H, W], in place, where it lies.

        Args:
            inverse_depth: [H, W].
            pixels: Flat indices of the pixels.
            rays: Directions of the pixels: x and y at z = 1, [H, W, 2].
            world_to_camera: Pose of the view, [4, 4].
        """
        to_reference = self.pose @ np.linalg.inv(world_to_camera)
        grid = (self.low, self.between, self.values)
        call(move_map, inverse_depth.view(-1), pixels, rays.view(-1, 2), to_reference, *grid)


class DepthField:
    """Computes the field's steps from the gradients of the scene.

    Args:
        settings: Grid and step sizes.
        reference: Index of the view over whose picture the grid lies.
        widest: Half of the picture's extent at z = 1, along rows and columns.
    """

    def __init__(self, settings: DepthFieldSettings, reference: int, widest: tuple[float, float]) -> None:
        self._settings = settings
        self._reference = reference
        self._widest = np.array(widest)
        self._grid: tuple[F64, F64] | None = None
        self.forget()

    def forget(self) -> None:
        """Forget the moments of earlier gradients."""
        shape = (self._settings.across, self._settings.down, self._settings.deep)
        self._mean, self._square, self._turns = np.zeros(shape), np.zeros(shape), 0
        self._relief = Relief()

    def step(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        progress: float,
        iteration: int,
        by_twists: Tensor | None = None,
    ) -> FieldStep | None:
        """Compute a step from the present gradients, without applying it; None if none is due.

        Args:
            scene: The Gaussians, with their gradients.
            world_to_camera: Poses, [N, 4, 4].
            progress: Share of the schedule that is done, in [0, 1]; it determines the step size.
            iteration: Number of iterations done.
            by_twists: Gradient by twists applied after the poses, translation in scene units first, [N, 6]; None if
                nothing is to be exchanged, because poses do not step or were given.
        """
        if iteration % self._settings.every or scene.means.grad is None or scene.log_scales.grad is None:
            return None
        poses = world_to_camera.detach().double().numpy()
        pose = poses[self._reference]
        low, between = self._grid = self._grid or self._over(scene, pose)
        found = scene.means.new_empty(self._mean.shape, dtype=torch.float64)
        call(
            gather_gradient,
            *(t.detach() for t in (scene.means, scene.means.grad, scene.log_scales.grad)),
            *(pose, NEAR, low, between, found),
        )
        gradient = found.cpu().numpy()
        if not np.isfinite(gradient).all():
            return None
        longest = self._settings.exchange
        step = FieldStep(pose, low, between, -self._rate(progress) * self._direction(gradient))
        if longest is None or by_twists is None:
            return step
        knots = tuple(at + apart * np.arange(n) for at, apart, n in zip(low, between, found.shape, strict=True))
        travel = relative_to(poses, self._reference)[:, :3, 3]
        exchanged = self._relief.step(gradient, by_twists, knots, travel, longest * 0.2**progress)
        return step if exchanged is None else replace(step, values=step.values + exchanged[0], twists=exchanged[1])

    def _rate(self, progress: float) -> float:
        rates = self._settings
        return float(rates.rate * (rates.final_rate / rates.rate) ** progress)

    def _direction(self, gradient: F64) -> F64:
        """Update Adam's moments by a gradient and return the direction of the step, at most about 1 at every knot.

        The mean square over all knots is added to that of each knot: without it, the steps in areas without texture,
        whose depth the measurement hardly determines, would be as long as elsewhere.
        """
        self._turns += 1
        self._mean += (1 - DECAY) * (gradient - self._mean)
        self._square += (1 - SQUARE_DECAY) * (gradient**2 - self._square)
        square = self._square / (1 - SQUARE_DECAY**self._turns)
        root = np.sqrt(square + square.mean() + np.finfo(np.float64).tiny)
        return self._mean / (1 - DECAY**self._turns) / root

    def _over(self, scene: Gaussians, pose: F64) -> tuple[F64, F64]:
        """Place the grid over a scene; return its first knot and the distances between knots, [3] each."""
        depth = scene.means.detach().double().cpu().numpy() @ pose[2, :3] + pose[2, 3]
        far, near = np.quantile(1 / depth[depth > NEAR], _QUANTILES)
        low = np.array([*-self._widest, far])
        high = np.array([*self._widest, max(near, far * (1 + 1e-3))])
        return low, (high - low) / (np.array(self._mean.shape) - 1)
