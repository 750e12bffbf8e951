"""The coarse stage: Gaussians and poses are fitted to the measurement together (paper, sections III-C and III-E).

Here: the loop, its bookkeeping and its safety net. Not here: what the loop is made of (losses, optimiser, poses,
density rules, stopping: one file each), nor the initial scene (`reconstruct.geometry`). For `reconstruct.pipeline`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.progress import Progress
from gs2ci.core.records import F32, F64
from gs2ci.core.run_records import CurvePoint
from gs2ci.reconstruct import coding
from gs2ci.reconstruct.fit.density.base import DensityRule, Evidence
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses import DataTerm, LossWeights, opacity_term
from gs2ci.reconstruct.fit.optimiser import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.poses import PoseCorrections, PoseSettings
from gs2ci.reconstruct.fit.stopping import HoldOut, Jury, Watch
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.backend import Backend
from gs2ci.render.gaussians import Gaussians

Score = Callable[[F32], float]
Refine = Callable[[F32], F32]


@dataclass(frozen=True)
class CoarseSettings:
    """The schedule of the coarse stage.

    Args:
        iterations: At most this many.
        densify_every: Iterations between turns of the density rule.
        densify_from: Share of the schedule before its first turn.
        densify_until: Share of the schedule after its last turn.
        gaussians_per_pixel: Population cap, as a share of the pixels of one view.
    """

    iterations: int = 1000
    densify_every: int = 100
    densify_from: float = 0.025
    densify_until: float = 0.75
    gaussians_per_pixel: float = 0.4
    loss: LossWeights = field(default_factory=LossWeights)
    steps: StepSizes = field(default_factory=StepSizes)
    poses: PoseSettings = field(default_factory=PoseSettings)
    hold_out: HoldOut = field(default_factory=HoldOut)
    density: DensityRule = field(default_factory=Osgr)

    def check(self) -> "CoarseSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: A count below 1, or hold-out settings out of range.
        """
        if self.iterations < 1 or self.densify_every < 1:
            raise InputError(
                f"{self.iterations} iterations of the fit, densified every {self.densify_every}",
                allowed="counts of at least 1",
            )
        self.hold_out.check()
        return self


@dataclass(frozen=True)
class CoarseFit:
    """What the coarse stage found.

    Args:
        scene: The Gaussians.
        world_to_camera: Refined poses, [N, 4, 4].
        views: The scene seen from there, [N, H, W, C] float32, not clamped.
        curve: How it came about.
        stopped_because: One sentence.
        notes: What the user should know besides: each time that numbers ran away.
    """

    scene: Gaussians
    world_to_camera: F64
    views: F32
    curve: tuple[CurvePoint, ...]
    stopped_because: str
    notes: tuple[str, ...]


@dataclass
class _Snapshot:
    """A state to go back to."""

    scene: Gaussians
    twists: Tensor
    iteration: int


class _Fit:
    """The state of one fit between iterations."""

    def __init__(
        self,
        jury: Jury,
        start: Gaussians,
        geometry: Geometry,
        backend: Backend,
        settings: CoarseSettings,
        seed: int,
    ) -> None:
        shot = jury.shot
        self.settings = settings
        self._backend = backend
        self._channels = coding.cfa_channels(shot.cfa, shot.size) if shot.cfa else None
        self._mono = shot.channels == 1
        self.size = shot.size
        self._intrinsics = torch.from_numpy(geometry.intrinsics).float()
        masks = torch.from_numpy(shot.masks * shot.weights[:, None, None])
        self._coding = backend.code(masks)
        self.extent = _extent(geometry.world_to_camera)
        self._depth_axis = torch.from_numpy(geometry.world_to_camera[geometry.reference]).float()[2]
        self.cap = max(len(start), int(settings.gaussians_per_pixel * shot.size[0] * shot.size[1]))
        self.optimiser = GaussianOptimiser(start, settings.steps, self.extent)
        self.poses = PoseCorrections(geometry.world_to_camera, settings.poses)
        self.data_term = DataTerm(shot.measurement, ~jury.heldout, shot.saturated, settings.loss.similarity)
        self.generator = torch.Generator().manual_seed(seed)
        self._gradient_sum = torch.zeros(len(start))
        self._gradient_count = 0

    def predict(self) -> Tensor:
        """Render the measurement that the present scene and poses would give, [H, W, C]."""
        image = self._backend.coded(self.optimiser.scene, self.poses.world_to_camera(), self._intrinsics, self._coding)
        if self._channels is not None:
            return coding.select(image, self._channels)
        return image.mean(dim=2, keepdim=True) if self._mono else image

    def views(self) -> F32:
        """Render the views, [N, H, W, C] float32, not clamped."""
        with torch.no_grad():
            images, _ = self._backend.views(
                self.optimiser.scene, self.poses.world_to_camera(), self._intrinsics, self.size
            )
        return (images.mean(dim=3, keepdim=True) if self._mono else images).numpy()

    def backward(self) -> float:
        """Accumulate gradients of the objective; return the loss, NaN where a parameter is not finite."""
        if not self.optimiser.scene_is_finite():
            return float("nan")
        data = self.data_term(self.predict())
        opacity = opacity_term(self.optimiser.scene.opacity_logits)
        loss = data + self.settings.loss.opacity * opacity
        loss.backward()  # type: ignore[no-untyped-call]
        return float(loss.detach())

    def is_finite(self, loss: float) -> bool:
        """Tell whether this iteration may be taken into the parameters."""
        return np.isfinite(loss) and self.optimiser.gradient_is_finite() and self.poses.gradient_is_finite()

    def note_gradient(self) -> None:
        """Accumulate what the density rule decides on: the gradient by the position on the screen."""
        scene = self.optimiser.scene
        if scene.means.grad is None:
            return
        depth = (scene.means.detach() @ self._depth_axis[:3] + self._depth_axis[3]).clamp(min=1e-3)
        # d loss / d screen position ≈ (d loss / d position) · depth / focal; in half image widths, as gsplat.
        per_width = depth / self._intrinsics[0, 0] * (self.size[1] / 2)
        self._gradient_sum += scene.means.grad.norm(dim=1) * per_width
        self._gradient_count += 1

    def densify(self) -> None:
        """Give the density rule its turn."""
        gradient = self._gradient_sum / max(1, self._gradient_count)
        evidence = Evidence(gradient, self.extent, self.cap)
        change = self.settings.density.change(self.optimiser.scene, evidence, self.generator)
        self.optimiser.replace(change.scene, change.source)
        self._forget_evidence()

    def _forget_evidence(self) -> None:
        self._gradient_sum = torch.zeros(len(self.optimiser.scene))
        self._gradient_count = 0

    def snapshot(self, iteration: int) -> _Snapshot:
        """Copy the present state."""
        copy = self.optimiser.scene.map(lambda tensor: tensor.detach().clone())
        return _Snapshot(copy, self.poses.snapshot(), iteration)

    def restore(self, state: _Snapshot) -> None:
        """Go back to a state."""
        self.optimiser.restore(state.scene)
        self.poses.restore(state.twists)
        self._forget_evidence()


def _extent(world_to_camera: F64) -> float:
    """Return the diameter of the camera path, with a floor for a camera that hardly moves.

    Depths are about one (`geometry` normalises them), so the floor is 2 % of the depth: without it nothing could
    move along a ray when the path is short.
    """
    centres = np.linalg.inv(world_to_camera)[:, :3, 3]
    return max(float(np.linalg.norm(centres.max(axis=0) - centres.min(axis=0))), 0.02)


MAX_ROLLBACKS = 3
# A loss so many times the least one since the population last changed, and at least this share of the first, is a step
# that exploded, however finite: the scene has left the frame, or its colours the range of light. (A density rule may
# raise the loss as much, which no step does.)
EXPLODED = 3.0
EXPLODED_SHARE_OF_FIRST = 0.3


def fit_coarse(
    jury: Jury,
    start: Gaussians,
    geometry: Geometry,
    backend: Backend,
    settings: CoarseSettings,
    seed: int,
    refine: Refine,
    progress: Progress,
    score: Score | None = None,
    since_s: float | None = None,
) -> CoarseFit:
    """Fit Gaussians and poses to the measurement.

    Args:
        jury: The measurement, its truth unread, and the pixels of it that the loss may not see.
        start: Initial Gaussians.
        geometry: Initial poses, and the camera matrix.
        backend: The renderer.
        settings: The schedule.
        seed: For the density rule's draws.
        refine: What will be done to the scene's views, [N, H, W, C], before they are handed over.
        progress: Told every iteration.
        score: Called with the refined views at each look; its value is reported as `psnr_db`.
        since_s: `time.monotonic()` when the whole reconstruction began; the curve's seconds count from there.

    Returns:
        The state with the best held-out residual.

    Raises:
        InputError: The settings make no sense.
        NumericsError: The very first iteration is not finite.
    """
    settings.check()
    origin_s = time.monotonic() if since_s is None else since_s
    fit = _Fit(jury, start, geometry, backend, settings, seed)
    loop = _Loop(fit, jury, refine, progress, score, origin_s)
    stopped_because = loop.run()
    fit.restore(loop.best)
    return CoarseFit(
        scene=loop.best.scene,
        world_to_camera=fit.poses.world_to_camera().detach().double().numpy(),
        views=fit.views(),
        curve=tuple(loop.curve),
        stopped_because=stopped_because,
        notes=tuple(loop.notes),
    )


class _Loop:
    """The iterations: step, densify, look, stop; and back to the last good state when numbers run away."""

    def __init__(
        self, fit: _Fit, jury: Jury, refine: Refine, progress: Progress, score: Score | None, origin_s: float
    ) -> None:
        self.fit = fit
        self.settings = fit.settings
        self.best = fit.snapshot(0)
        self.curve: list[CurvePoint] = []
        self.notes: list[str] = []
        self._jury = jury
        self._refine = refine
        self._progress = progress
        self._score = score
        self._origin_s = origin_s
        self._watch = Watch(fit.settings.hold_out)
        self._damping = 1.0
        self._rollbacks = 0
        self._first_loss: float | None = None
        self._least_loss = float("inf")

    def run(self) -> str:
        """Iterate until something says stop; return what."""
        total = self.settings.iterations
        self._progress.stage("fit", total)
        iteration = 0
        while iteration < total:
            loss = self.fit.backward()
            ran_away = self._how_it_ran_away(loss)
            if ran_away:
                if not self._roll_back(iteration, ran_away):
                    return f"numbers ran away {MAX_ROLLBACKS} times; kept the state of iteration {self.best.iteration}"
                continue
            self._step(iteration)
            iteration += 1
            if iteration % self.settings.hold_out.look_every == 0 or iteration == total:
                self._look(iteration, loss)
                if self._watch.stalled(iteration):
                    return f"held-out pixels stopped improving at iteration {self._watch.best_iteration}"
            self._progress.step(iteration, loss=loss, **self._figures())
        if not self._jury.heldout.any():
            return f"all {total} iterations done, no pixels held out to judge them"
        return f"all {total} iterations done, held-out pixels best at iteration {self._watch.best_iteration}"

    def _step(self, iteration: int) -> None:
        share = iteration / self.settings.iterations
        self.fit.note_gradient()
        self.fit.optimiser.step(share, self._damping)
        self.fit.poses.step(share)
        begin, end = self.settings.densify_from, self.settings.densify_until
        turn = begin <= share < end and iteration % self.settings.densify_every == 0
        if turn and self._watch.may_grow(iteration):
            self.fit.densify()
            self._least_loss = float("inf")

    def _look(self, iteration: int, loss: float) -> None:
        """Judge the views as they would be handed over now, and remember the state if it is the best."""
        views = self._refine(self.fit.views())
        heldout = self._jury.residual_rms(views)
        if self._watch.note(heldout, iteration):
            self.best = self.fit.snapshot(iteration)
        self.curve.append(
            CurvePoint(
                seconds=time.monotonic() - self._origin_s,
                iteration=iteration,
                loss=loss,
                heldout=heldout,
                psnr_db=None if self._score is None else self._score(views),
                gaussians=len(self.fit.optimiser.scene),
            )
        )

    def _figures(self) -> dict[str, float | int]:
        """Return what the last look found, for the display."""
        figures: dict[str, float | int] = {}
        if self.curve and self.curve[-1].heldout is not None:
            figures["heldout"] = self.curve[-1].heldout
        if self.curve and self.curve[-1].psnr_db is not None:
            figures["psnr_db"] = self.curve[-1].psnr_db
        return {**figures, "gaussians": len(self.fit.optimiser.scene)}

    def _how_it_ran_away(self, loss: float) -> str:
        """Say what is wrong with the present iteration; nothing if it may be taken."""
        if not self.fit.is_finite(loss):
            return "was not finite"
        if self._first_loss is None:
            self._first_loss = loss
        if loss > EXPLODED * self._least_loss and loss > EXPLODED_SHARE_OF_FIRST * self._first_loss:
            return f"exploded, the loss rose from {self._least_loss:.3g} to {loss:.3g}"
        self._least_loss = min(self._least_loss, loss)
        return ""

    def _roll_back(self, iteration: int, ran_away: str) -> bool:
        if iteration == 0:
            raise NumericsError(
                "the first iteration of the fit is not finite",
                allowed="finite measurement, masks, poses and Gaussians",
                remedy="run `gs2ci import` on the measurement again and read its warnings",
            )
        if self._rollbacks == MAX_ROLLBACKS:
            return False
        self._rollbacks += 1
        self._damping *= 0.5
        self.fit.restore(self.best)
        self._least_loss = float("inf")
        note = f"Iteration {iteration} {ran_away}: back to iteration {self.best.iteration} with half the step."
        self.notes.append(note)
        self._progress.say(note)
        return True
