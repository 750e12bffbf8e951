"""Camera poses as corrections in se(3) of their initial estimates: Tᵢ = exp(ξᵢ) Tᵢ⁽⁰⁾ (paper, section III-C).

Here: the parameters, their optimiser and its schedule, the lengths that step sizes are measured in, and the prior on
given poses. Not here: the initial poses, and the standard errors of given ones (`reconstruct.geometry`).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres, path_extent
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.scene.rigid import RigidMotions
from gs2ci.reconstruct.geometry.path.telemetry import PoseErrors
from gs2ci.render.adjoint import Image
from gs2ci.render.gaussians import all_finite

LengthUnit = Literal["median depth", "path diameter", "path cube"]
"""The unit of lengths. "path cube" is the unit of nerfstudio, on which the paper builds: its parser subtracts the mean
of the camera positions and scales them into a cube of side two, so that the largest coordinate is one."""

# A floor for cameras that hardly move: depths are about one (`geometry` normalises them), so this is 2 % of the depth.
# Without it nothing could move along a ray when the path is short.
LEAST_EXTENT = 0.02
# The first steps of given poses, in their standard errors.
_STEP_IN_ERRORS = 0.2


@dataclass(frozen=True)
class PoseSettings:
    """How poses are refined.

    Args:
        refine: Whether they are refined at all.
        every: Gradients are accumulated over this many iterations before a step. The paper takes 25; on a schedule
            of 600 iterations 5 gave 0.5 dB more, on one of 150 steps at every iteration another 0.2 to 0.5.
        rate: Initial step size of Adam, in radians and in `unit`.
        final_rate: Step size at the end; exponential in between.
        unit: Of translations.
        given_weight: Cost of a correction by one standard error of poses that were given with an error, in the unit of
            the loss, mean over views and components: the penalty of a normal prior; 0 for none. With half of it and an
            error of 1 % of the path, exact poses of four scenes moved by 0.1 to 0.5 % of the path, with a twentieth of
            it by 0.6 % in one, without it by 1 to 6 % (`python -m tests.benchmarks given_poses`).
    """

    refine: bool = True
    every: int = 1
    rate: float = 3e-3
    final_rate: float = 6e-6
    unit: LengthUnit = "median depth"
    given_weight: float = 2e-3


def path_length(world_to_camera: F64) -> float:
    """Return the diameter of a camera path, [N, 4, 4], with a floor for a camera that hardly moves."""
    return max(path_extent(world_to_camera), LEAST_EXTENT)


def length_of(unit: LengthUnit, world_to_camera: F64) -> float:
    """Return a unit of length in scene units, given a camera path, [N, 4, 4], of a scene with depths about one."""
    if unit == "median depth":
        return 1.0
    if unit == "path diameter":
        return path_length(world_to_camera)
    centres = camera_centres(world_to_camera)
    return max(float(np.abs(centres - centres.mean(axis=0)).max()), LEAST_EXTENT / 2)


@dataclass(frozen=True, eq=False)
class PosesState:
    """Twists, [N, 6], their gradient so far, of how many iterations that is, and the moments of what came before."""

    twists: Tensor
    gradient: Tensor | None
    accumulated: int
    adam: Adam | None


class PoseCorrections:
    """One twist per view, [N, 6] (translation first), optimised by Adam on accumulated gradients."""

    def __init__(self, world_to_camera: F64, settings: PoseSettings, errors: PoseErrors | None = None) -> None:
        """Start at given poses, [N, 4, 4]; `errors` are standard errors, None if they are unknown."""
        self._initial = torch.from_numpy(world_to_camera).float()
        self._exactly = self._initial.double().numpy()
        # Adam moves every parameter by the same step, so translations are parameters in their own unit.
        length = length_of(settings.unit, world_to_camera)
        self._units = torch.tensor([length] * 3 + [1.0] * 3)
        self._errors: Tensor | None = None
        if errors is not None and settings.given_weight > 0:
            spread = torch.tensor([errors.position] * 3 + [errors.rotation] * 3, dtype=torch.float32)
            # Steps are small compared with the errors; otherwise poses would scatter further than the prior allows.
            self._units = torch.minimum(self._units, spread * (_STEP_IN_ERRORS / settings.rate))
            self._errors = spread / self._units
        self._settings = settings
        self._twists = torch.zeros(len(world_to_camera), 6, requires_grad=settings.refine)
        self._adam = Adam() if settings.refine else None
        self._accumulated = 0
        self._now: RigidMotions | None = None

    def world_to_camera(self) -> Tensor:
        """Return the corrected poses, [N, 4, 4] float32."""
        if self._adam is None:
            return self._initial
        return torch.from_numpy((self._corrections().matrices @ self._exactly).astype(np.float32))

    def pull(self, world_to_camera: Tensor, gradient: Image) -> None:
        """Accumulate the gradient by the twists, from a gradient by the poses, [N, 4, 4].

        Args:
            world_to_camera: The present poses, at which the gradient was taken.
            gradient: By the poses; their last rows are ignored. From a device it is read back: twists are a few numbers
                a view, and a device would take a hundred launches for what the host does at once.
        """
        if self._adam is None:
            return
        if self._twists.grad is None:
            self._twists.grad = torch.zeros_like(self._twists)
        by_poses = torch.as_tensor(gradient).cpu().double().numpy()
        by_twists = self._corrections().by_twists(world_to_camera.double().numpy(), by_poses)
        self._twists.grad += torch.from_numpy(by_twists) * self._units

    def _corrections(self) -> RigidMotions:
        """Return the present corrections, computed once after each change of the twists."""
        if self._now is None:
            self._now = RigidMotions((self._units.double() * self._twists.detach()).numpy())
        return self._now

    def penalty(self) -> Tensor | float:
        """Return the cost of the corrections by the prior on given poses, [] (see `PoseSettings.given_weight`)."""
        if self._errors is None or self._adam is None:
            return 0.0
        return self._settings.given_weight * ((self._twists / self._errors) ** 2).mean()

    def step(self, progress: float, damping: float = 1.0) -> None:
        """Count one more accumulated gradient, and step if a step is due.

        Args:
            progress: Share of the schedule that is done, in [0, 1]: sets the step size.
            damping: Further factor on the step size.
        """
        if self._adam is None or self._twists.grad is None:
            return
        self._accumulated += 1
        if self._accumulated < self._settings.every:
            return
        self._twists.grad /= self._accumulated
        rates = self._settings
        self._adam.step(self._twists, rates.rate * (rates.final_rate / rates.rate) ** progress * damping)
        self._now = None
        self.forget_gradient()

    def gradient(self) -> Tensor | None:
        """Return the accumulated gradient by twists in scene units, [N, 6]; None if there is none."""
        return None if self._twists.grad is None else self._twists.grad / self._units

    def shift(self, twists: Tensor) -> None:
        """Move the cameras by small twists after their poses, in scene units, [N, 6]; Adam's moments stay."""
        with torch.no_grad():
            self._twists.add_(twists / self._units)
        self._now = None

    def forget_gradient(self) -> None:
        """Discard the accumulated gradient."""
        self._twists.grad = None
        self._accumulated = 0

    def gradient_is_finite(self) -> bool:
        """Tell whether the accumulated gradient is free of NaN and infinities."""
        return self._twists.grad is None or all_finite(self._twists.grad)

    def snapshot(self) -> Tensor:
        """Return a copy of the twists, [N, 6]."""
        return self._twists.detach().clone()

    def state(self) -> PosesState:
        """Return the twists and what their next step follows from."""
        adam = None if self._adam is None else replace(self._adam)
        return PosesState(self._twists.detach(), self._twists.grad, self._accumulated, adam)

    def resume(self, state: PosesState) -> None:
        """Go on from the state of another."""
        self.restore(state.twists)
        self._twists.grad, self._accumulated = state.gradient, state.accumulated
        if self._adam is not None and state.adam is not None:
            self._adam.resume(state.adam)

    def restore(self, twists: Tensor) -> None:
        """Go back to a snapshot, [N, 6]; the optimiser forgets its momentum, which led away from it."""
        with torch.no_grad():
            self._twists.copy_(twists)
        self._now = None
        self.forget_gradient()
        if self._adam is not None:
            self._adam = Adam()
