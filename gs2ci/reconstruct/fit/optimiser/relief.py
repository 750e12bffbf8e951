"""The bas-relief ambiguity of camera path and scene, as one parameter of the fit.

If a constant is added to all inverse depths and each camera is turned to undo the shift of its picture, the views
hardly change: a camera that turns a little looks like one that travels past something a little nearer (Belhumeur,
Kriegman and Yuille 1999; for motion, Daniilidis and Spetsakis 1997). Only perspective at the borders of the picture, a
few tenths of a pixel, tells the two apart. Poses and Gaussians with separate steps do not follow so shallow a valley in
a few hundred iterations, since every Gaussian would have to move with every camera. A step of this parameter moves all
of them together.

With the reference camera as the frame, X = z (u, v, 1), translations t_i of the others and e the direction across the
image in which most of them lie, the step by beta is, to first order,

    1/z  ->  1/z + beta (1 + ((u, v) . e)^2),       camera i turns by beta (t_y, -t_x, 0),

where the square compensates the part of a turn's shift along the path that is not constant. What remains is a shift by
-beta (t . u) across the path, in px times the focal length: it is zero in the middle of the picture, and by it the
measurement decides. Everything is then scaled so that the median depth stays the same.

Here: the direction, and its steps. Not here: the gradients (`coarse/stage.py`), the poses (`poses.py`).
"""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.relief_kernels import derivative_along, step_of_gaussians, take_step
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians

# Bound on (u, v) along the path: a field of view of 90 degrees.
WIDEST: Final = 1.0


@dataclass(frozen=True)
class ReliefSettings(Bounded):
    """How inverse depth and turning are exchanged.

    Args:
        begins: Share of the schedule before the first step: the first Gaussians are faint, and their gradients mislead.
        rate: Adam's step at the start of the schedule, in units of inverse depth, whose median is about 1.
        final_rate: At its end; exponential in between.
    """

    begins: Annotated[float, Field(ge=0, lt=1)] = 0.1
    rate: Positive = 1.5e-2
    final_rate: Positive = 3e-3


@dataclass(frozen=True)
class ReliefStep:
    """Derivatives by beta of everything that moves with it.

    Args:
        means: [G, 3].
        log_sizes: Of every axis of each Gaussian, [G].
        twists: Of the cameras, applied after their poses: translation in scene units first, [N, 6].
        bend: Direction, [2]: off the reference view's axis, the addition to inverse depth grows by the square of the
            component of (u, v) along it.
        shrink: The share by which inverse depths are divided afterwards.
    """

    means: Tensor
    log_sizes: Tensor
    twists: Tensor
    bend: Tensor
    shrink: float


def relief_step(scene: Gaussians, world_to_camera: Tensor, reference: int) -> ReliefStep:
    """Find the direction at a scene and its cameras.

    Args:
        scene: The Gaussians.
        world_to_camera: Poses, [N, 4, 4].
        reference: The view whose centre stays in place.
    """
    poses = world_to_camera.detach().double().numpy()
    own = poses[reference]
    travel = (poses @ np.linalg.inv(own))[:, :3, 3]
    bend = _main_direction(travel[:, :2])
    means = scene.means.detach().contiguous()
    by_means, by_sizes = torch.empty_like(means), means.new_empty(len(means))
    shrink = float(call(step_of_gaussians, means, own, bend, NEAR, WIDEST, by_means, by_sizes))
    turns = np.stack([travel[:, 1], -travel[:, 0], np.zeros(len(travel))], axis=1)
    twists = torch.from_numpy(np.concatenate([shrink * travel, turns], axis=1)).to(world_to_camera.dtype)
    return ReliefStep(by_means, by_sizes, twists, torch.from_numpy(bend).to(means.dtype), shrink)


def _main_direction(vectors: F64) -> F64:
    """Return the unit vector along which vectors, [N, 2], are longest in the mean square; its sign is arbitrary."""
    (xx, xy), (_, yy) = vectors.T @ vectors
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    return np.array([np.cos(angle), np.sin(angle)])


class Relief:
    """Steps along that direction by Adam, from the present gradients of scene and poses.

    Args:
        settings: Of the steps.
        reference: The view whose centre stays in place.
    """

    def __init__(self, settings: ReliefSettings, reference: int) -> None:
        self._settings = settings
        self._reference = reference
        self._beta = torch.zeros((), dtype=torch.float64)
        self._adam = Adam()

    @property
    def moved(self) -> float:
        """Get the sum of all steps, in units of the inverse depths."""
        return float(self._beta)

    def forget(self) -> None:
        """Forget the moments of earlier gradients."""
        self._adam = Adam()

    def step(
        self, scene: Gaussians, world_to_camera: Tensor, twist_gradient: Tensor, progress: float
    ) -> "Exchange | None":
        """Choose a step by the present gradients; the caller applies it.

        None before steps begin, if a gradient is not finite, and if the camera moves forward more than sideways, since
        then no turn looks like travel.

        Args:
            scene: The Gaussians, with their gradients.
            world_to_camera: Poses, [N, 4, 4].
            twist_gradient: By twists applied after them, translation in scene units first, [N, 6].
            progress: Share of the schedule that is done, in [0, 1]: sets the step size.
        """
        if progress < self._settings.begins:
            return None
        along = relief_step(scene, world_to_camera, self._reference)
        aside, forward = along.twists[:, 3:].square().sum(), (along.twists[:, 2] / along.shrink).square().sum()
        if not bool(aside > forward):
            return None
        gradient = _gradient(scene, twist_gradient, along)
        if not bool(torch.isfinite(gradient)):
            return None
        self._beta.grad = gradient
        before = self.moved
        rates = self._settings
        self._adam.step(self._beta, rates.rate * (rates.final_rate / rates.rate) ** progress)
        self._beta.grad = None
        return Exchange(along, self.moved - before)


@dataclass(frozen=True)
class Exchange:
    """A step by `beta` along a direction."""

    along: ReliefStep
    beta: float

    def of_scene(self, scene: Gaussians) -> None:
        """Move Gaussians, in place."""
        along = self.along
        call(take_step, scene.means.detach(), scene.log_scales.detach(), along.means, along.log_sizes, self.beta)

    @property
    def twists(self) -> Tensor:
        """Get the cameras' motion, applied after their poses: translation in scene units first, [N, 6]."""
        return self.beta * self.along.twists


def _gradient(scene: Gaussians, twist_gradient: Tensor, along: ReliefStep) -> Tensor:
    """Return the derivative of the objective by beta."""
    total = float((twist_gradient * along.twists).sum(dtype=torch.float64))
    moved = ((scene.means, along.means), (scene.log_scales, along.log_sizes[:, None]))
    parts = [call(derivative_along, one.grad, step) for one, step in moved if one.grad is not None]
    if parts and isinstance(parts[0], Tensor):  # read back at once
        parts = torch.stack(parts).tolist()
    for part in parts:
        total += part
    return torch.tensor(total, dtype=torch.float64)
