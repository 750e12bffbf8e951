"""The coarse stage: Gaussians and poses are fitted to the measurement together (paper, sections III-C and III-E).

Here: the loop, its bookkeeping and its safety net. Not here: what the loop is made of (losses, optimiser, poses,
density rules, stopping: one file each), nor the initial scene (`reconstruct.geometry`).
"""

import sys
import time
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, NumericsError, ResourceError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress
from gs2ci.core.run_records import CurvePoint
from gs2ci.reconstruct.fit.colours import ColourSettings
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.gathering import Gathering
from gs2ci.reconstruct.fit.looks import Looks, Refine, Score
from gs2ci.reconstruct.fit.losses import DataTerm, LossWeights, add_regularisers
from gs2ci.reconstruct.fit.mask_moments import MaskMoments
from gs2ci.reconstruct.fit.motion import ObjectMotionSettings
from gs2ci.reconstruct.fit.optimiser import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.pace import Fixed, Pace
from gs2ci.reconstruct.fit.poses import PoseCorrections, PoseSettings, length_of
from gs2ci.reconstruct.fit.raster_order import raster_order
from gs2ci.reconstruct.fit.relief import Exchange, Relief, ReliefSettings
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.stopping import HoldOut, Rival, Watch
from gs2ci.reconstruct.fit.surfaces import Surfaces, SurfaceSettings, find_surfaces
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.sources import TOLD
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend

STANDARD_ITERATIONS: Final = 400
"""Of the default schedule. Half as many lose up to 1 dB for 0.7 of the time
(docs/decisions/0051-shorter-schedule.md)."""


@dataclass(frozen=True)
class CoarseSettings:
    """The schedule of the coarse stage.

    Args:
        iterations: At most this many.
        densify_every: Iterations between turns of the density rule.
        densify_from: Share of the schedule before its first turn.
        densify_until: Share of the schedule after its last turn.
        gaussians_per_pixel: Population cap, as a share of the pixels of one view; None for none.
        most_gaussians: Population beyond which the fit ends with an error, for want of memory; None for no such guard.
        cap_from: Share of the schedule after which the population may not exceed what it is then; None for never.
        surfaces: How light is gathered on surfaces; None leaves that to the measurement.
        relief: How turning is exchanged for travel where nobody told the path; None never does.
        per_open_share: Whether the gradients that density rules see are divided by the masks' share of open pixels, so
            that thresholds found on photographs hold (`gathering.py`).
        motion: How Gaussians may move that begin with a motion.
        colours: How far colours may change with the direction of sight.
    """

    iterations: int = STANDARD_ITERATIONS
    densify_every: int = STANDARD_ITERATIONS // 8
    densify_from: float = 0.025
    densify_until: float = 0.75
    gaussians_per_pixel: float | None = 0.25
    most_gaussians: int | None = None
    cap_from: float | None = None
    surfaces: SurfaceSettings | None = field(default_factory=SurfaceSettings)
    relief: ReliefSettings | None = field(default_factory=ReliefSettings)
    per_open_share: bool = True
    loss: LossWeights = field(default_factory=LossWeights)
    steps: StepSizes = field(default_factory=lambda: StepSizes.of_schedule(STANDARD_ITERATIONS))
    poses: PoseSettings = field(default_factory=PoseSettings)
    hold_out: HoldOut = field(default_factory=HoldOut)
    density: DensityRule = field(default_factory=Osgr.sparing)
    motion: ObjectMotionSettings = field(default_factory=ObjectMotionSettings)
    colours: ColourSettings = field(default_factory=ColourSettings)

    def check(self) -> "CoarseSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: A count below 1, no bound on the population at all, an exchange of turning for travel between
                steps of the poses, or the loss's window or hold-out settings out of range.
        """
        if self.iterations < 1 or self.densify_every < 1:
            raise InputError(
                f"{self.iterations} iterations of the fit, densified every {self.densify_every}",
                allowed="counts of at least 1",
            )
        if self.gaussians_per_pixel is None and self.most_gaussians is None:
            raise InputError(
                "a fit without any bound on its population",
                allowed="gaussians_per_pixel, which limits it, or most_gaussians, which ends the fit",
            )
        self.loss.check()
        if self.surfaces is not None:
            self.surfaces.check()
        if self.relief is not None:
            self.relief.check()
            if self.poses.every != 1:
                raise InputError(
                    f"an exchange of turning for travel in a fit whose poses step every {self.poses.every} iterations",
                    allowed="poses that step at every iteration, or no relief settings",
                )
        self.hold_out.check()
        self.motion.check()
        self.colours.check()
        return self


@dataclass(frozen=True)
class CoarseFit:
    """What the coarse stage found.

    Args:
        scene: The Gaussians.
        world_to_camera: Refined poses, [N, 4, 4].
        views: The scene as each mask saw it from there while it was on show, [N, H, W, C] float32, not clamped.
        curve: How it came about.
        stopped: Why it ended.
        notes: What the user should know besides: each time that numbers ran away.
    """

    scene: Gaussians
    world_to_camera: F64
    views: F32
    curve: tuple[CurvePoint, ...]
    stopped: Finding
    notes: tuple[Finding, ...]


@dataclass
class _Snapshot:
    """A state to go back to."""

    scene: Gaussians
    twists: Tensor
    iteration: int
    surfaces: Surfaces | None


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
        lens: Lens | None,
        mask_moments: MaskMoments | None,
    ) -> None:
        shot = jury.shot
        self._lens, self._seed = lens, seed
        # Where no parallax was found, views show no depth.
        moved = settings.surfaces is not None and geometry.verdict == "full"
        self._searches = list(settings.surfaces.searches) if moved and settings.surfaces is not None else []
        self._surfaces: Surfaces | None = None
        self._exchange: Exchange | None = None
        # A stage or a file tells how the camera turned; and what moves in a scene looks like depth.
        free = geometry.verdict == "full" and geometry.source not in TOLD and start.motion is None
        self._relief = Relief(settings.relief, geometry.reference) if settings.relief is not None and free else None
        self.settings = settings
        self._renderer = ShotRenderer(shot, geometry.intrinsics, backend, lens, mask_moments)
        self._gathering = Gathering(self._renderer, len(start), per_open_share=settings.per_open_share)
        self._reuse = self._renderer.reuse()
        # At a depth of 1, which is the scene's median.
        self._px_per_length = float(geometry.intrinsics[0, 0])
        self._pixels = shot.size[0] * shot.size[1]
        self.extent = length_of(settings.steps.unit, geometry.world_to_camera)
        self.cap = _UNBOUNDED
        if settings.gaussians_per_pixel is not None:
            self.cap = max(len(start), int(settings.gaussians_per_pixel * shot.size[0] * shot.size[1]))
        self._bounded = False
        self.optimiser = GaussianOptimiser(start, settings.steps, self.extent)
        self.poses = PoseCorrections(geometry.world_to_camera, settings.poses, geometry.pose_errors)
        self.data_term = DataTerm(shot.measurement, ~jury.heldout, shot.saturated, settings.loss)
        self.generator = torch.Generator().manual_seed(seed)

    def views(self) -> F32:
        """Render what each mask saw, [N, H, W, C] float32, not clamped."""
        return self._renderer.exposed(self.optimiser.scene, self.poses.world_to_camera())

    def backward(self, share: float, iteration: int) -> float:
        """Accumulate gradients of the objective.

        Args:
            share: Of the schedule that is done.
            iteration: How many are.

        Returns:
            The loss without the surfaces' and the motion's part of it, NaN where a parameter is not finite.
        """
        if not self.optimiser.scene_is_finite():
            return float("nan")
        self.optimiser.let_colours_vary(self.settings.colours.at(share))
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        predicted, pull = self._renderer.measurement_with_pull(scene, poses, self._reuse, self._gathering.screen)
        loss, gradient = self.data_term.value_and_gradient(predicted)
        self.poses.pull(poses, pull(gradient))
        loss += add_regularisers(scene, self.settings.loss)
        for further in (self.settings.motion.penalty(scene, self._px_per_length, self._pixels), self.poses.penalty()):
            if isinstance(further, Tensor):
                further.backward()  # type: ignore[no-untyped-call]
        # Before the surfaces' term: they move with an exchange, and have no say in it.
        self._exchange = self._exchange_wanted(poses, share)
        if self._surfaces is not None:
            turn, between = divmod(iteration, self._surfaces.settings.every)
            if between == 0:
                self._surfaces.draw(self._renderer, scene, poses, turn, self._surfaces.search.weight_at(share))
        return loss

    @property
    def awaits_surfaces(self) -> bool:
        """Get whether surfaces are yet to be looked for."""
        return bool(self._searches)

    def find_surfaces(self, share: float, refine: Refine) -> bool:
        """Look for surfaces when it is time to, and tell whether some were found now.

        The views are swept as they would be handed over, with their residual put back: a sweep of the final ones is
        nearer the truth than the scene that they were rendered from (docs/decisions/0058-depth-worth-measuring-in.md).
        """
        settings = self.settings.surfaces
        if settings is None or not self._searches or share < self._searches[0].begins:
            return False
        search = self._searches.pop(0)
        scene, poses = self.optimiser.scene.detach(), self.poses.world_to_camera().detach().double().numpy()
        views = refine(self.views())
        found = find_surfaces(self._renderer, scene, poses, views, settings, self._lens, self._seed, search)
        self._surfaces = found or self._surfaces
        return found is not None

    def is_finite(self, loss: float) -> bool:
        """Tell whether this iteration may be taken into the parameters."""
        return np.isfinite(loss) and self.optimiser.gradient_is_finite() and self.poses.gradient_is_finite()

    def step(self, share: float, damping: float) -> None:
        """Take the gradients into the parameters, and let the density rule shake the Gaussians."""
        exchange = self._exchange
        self.optimiser.step(share, damping)
        self.poses.step(share)
        if exchange is not None:
            exchange.of_scene(self.optimiser.scene)
            self.poses.shift(exchange.twists)
            if self._surfaces is not None:
                self._surfaces = self._surfaces.exchanged(exchange)
        rate = self.optimiser.means_rate(share, damping)
        moves = self.settings.density.shake(self.optimiser.scene, rate, self.generator)
        if moves is not None:
            self.optimiser.shift(moves)

    def _exchange_wanted(self, poses: Tensor, share: float) -> Exchange | None:
        """Choose how much turning becomes travel, by the present gradients; None where that is not wanted."""
        gradient = self.poses.gradient()
        if self._relief is None or gradient is None:
            return None
        return self._relief.step(self.optimiser.scene, poses, gradient, share)

    def bound_population(self) -> None:
        """Let the population grow no larger than it is at the first call (paper, supplement II)."""
        if not self._bounded:
            self.cap = min(self.cap, len(self.optimiser.scene))
            self._bounded = True

    def densify(self, iteration: int) -> bool:
        """Give the density rule its turn; return whether it set the fit back on purpose, as a reset does.

        Raises:
            ResourceError: It wants more Gaussians than the memory guard allows.
        """
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        evidence = self._gathering.evidence(
            scene, poses, self._dissimilarity, extent=self.extent, cap=self.cap, iteration=iteration
        )
        change = self.settings.density.change(scene, evidence, self.generator)
        _guard_memory(len(change.scene), self.settings.most_gaussians, iteration)
        middle = poses[len(poses) // 2].detach()
        order = raster_order(change.scene.means.detach(), middle, self._renderer.intrinsics)
        self.optimiser.replace(change.scene.map(lambda rows: rows[order]), change.source[order], change.forget)
        self._meet_others()
        return bool(change.forget)

    def _meet_others(self) -> None:
        """Forget what was seen of the Gaussians and what their renderings shared: they are others now."""
        self._gathering.start_again(len(self.optimiser.scene))
        self._reuse = self._renderer.reuse()

    def _dissimilarity(self) -> Tensor:
        """Return what is wrong with the present prediction, [H, W]."""
        scene, poses = self.optimiser.scene, self.poses.world_to_camera()
        predicted, _ = self._renderer.measurement_with_pull(scene, poses, self._reuse)
        return torch.from_numpy(self.data_term.dissimilarity(predicted))

    def snapshot(self, iteration: int) -> _Snapshot:
        """Copy the present state."""
        copy = self.optimiser.scene.map(lambda tensor: tensor.detach().clone())
        return _Snapshot(copy, self.poses.snapshot(), iteration, self._surfaces)

    def restore(self, state: _Snapshot) -> None:
        """Go back to a state."""
        self.optimiser.restore(state.scene)
        self.poses.restore(state.twists)
        # Found once, they stay; but they have moved with the path.
        self._surfaces = state.surfaces or self._surfaces
        self._meet_others()


_UNBOUNDED: Final = sys.maxsize


def _guard_memory(count: int, most: int | None, iteration: int) -> None:
    """Refuse a population that the memory guard does not allow."""
    if most is not None and count > most:
        raise ResourceError(
            f"the density rule wants {count:,} Gaussians at iteration {iteration}",
            allowed=f"at most {most:,}, the memory guard of this fit",
            remedy="bound the population (leave out `--without count-cap`), take another preset, or a smaller picture",
        )


# Each halves the step: what runs away with an eighth of it does not do so for its length.
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
    pace: Pace | None = None,
    lens: Lens | None = None,
    halt: Halt | None = None,
    mask_moments: MaskMoments | None = None,
    rival: Rival | None = None,
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
        pace: Decides how many iterations there are, instead of the settings.
        lens: Through which the measurement was taken, unless it is a pinhole.
        halt: Ends the fit after an iteration in which it is asked to.
        mask_moments: The moments of each mask, where the camera moves so far while it is on show.
        rival: Another fit; this one ends at a look at which it is far behind.

    Returns:
        The state with the best held-out residual.

    Raises:
        InputError: The settings make no sense.
        NumericsError: The very first iteration is not finite.
        ResourceError: The population outgrew the memory guard.
    """
    settings.check()
    fit = _Fit(jury, start, geometry, backend, settings, seed, lens, mask_moments)
    looks = Looks(jury, refine, score, since_s)
    loop = _Loop(
        fit, looks, progress, pace or Fixed(settings.iterations), halt or Halt(), rival, judged=bool(jury.heldout.any())
    )
    stopped = loop.run()
    fit.restore(loop.best)
    return CoarseFit(
        scene=loop.best.scene,
        world_to_camera=fit.poses.world_to_camera().detach().double().numpy(),
        views=fit.views(),
        curve=tuple(looks.curve),
        stopped=stopped,
        notes=tuple(loop.notes),
    )


class _Loop:
    """The iterations: step, densify, look, stop; and back to the last good state when numbers run away."""

    def __init__(
        self, fit: _Fit, looks: Looks, progress: Progress, pace: Pace, halt: Halt, rival: Rival | None, *, judged: bool
    ) -> None:
        self.fit = fit
        self.settings = fit.settings
        self.best = fit.snapshot(0)
        self.notes: list[Finding] = []
        self._looks = looks
        self._progress = progress
        self._pace = pace
        self._halt = halt
        self._rival = rival
        self._judged = judged
        self._watch = Watch(fit.settings.hold_out)
        self._damping = 1.0
        self._rollbacks = 0
        self._first_loss: float | None = None
        self._least_loss = float("inf")

    def run(self) -> Finding:
        """Iterate until something says stop; return what."""
        total = self._pace.total(0)
        self._progress.stage("fit", total)
        iteration = 0
        while iteration < total:
            if self.fit.find_surfaces(iteration / total, self._looks.refine):
                # Whatever is handed over has had its light gathered: an earlier state may show the held-out pixels
                # as well, but not where things are.
                self._watch.begin_again(iteration)
            loss = self.fit.backward(iteration / total, iteration)
            ran_away = self._how_it_ran_away(iteration, loss)
            if ran_away is not None:
                if not self._roll_back(iteration, ran_away):
                    return finding(Code.FIT_DIVERGED, times=MAX_ROLLBACKS, best=self.best.iteration)
                continue
            self._step(iteration, total)
            iteration += 1
            before, total = total, self._pace.total(iteration)
            if total != before:
                self._progress.expect(total)
            halted = self._halt.asked
            looks = iteration % self.settings.hold_out.look_every == 0 or iteration >= total or halted
            if looks:
                self._look(iteration, loss)
            self._progress.step(iteration, loss=loss, **self._figures())
            if halted:
                return finding(Code.FIT_INTERRUPTED, iterations=iteration, best=self._watch.best_iteration)
            if looks and self._is_behind(iteration):
                return finding(Code.FIT_BEHIND, iterations=iteration, best=self._watch.best_iteration)
            if looks and self._watch.stalled(iteration) and not self.fit.awaits_surfaces:
                return finding(Code.FIT_STALLED, best=self._watch.best_iteration)
        late = self._pace.is_late(iteration)
        if not self._judged:
            return finding(Code.FIT_TIME_UP_UNJUDGED if late else Code.FIT_ALL_DONE_UNJUDGED, iterations=iteration)
        code = Code.FIT_TIME_UP if late else Code.FIT_ALL_DONE
        return finding(code, iterations=iteration, best=self._watch.best_iteration)

    def _is_behind(self, iteration: int) -> bool:
        """Tell whether another fit is so far ahead at the look just taken that this one is given up."""
        return self._rival is not None and self._rival.is_out_of_reach(self._looks.curve[-1].heldout, iteration)

    def _step(self, iteration: int, total: int) -> None:
        share = iteration / total
        self.fit.step(share, self._damping)
        begin, end, bound = self.settings.densify_from, self.settings.densify_until, self.settings.cap_from
        if bound is not None and share >= bound:
            self.fit.bound_population()
        turn = begin <= share < end and iteration % self.settings.densify_every == 0
        if turn and self._watch.may_grow(iteration):
            self._least_loss = float("inf")
            if self.fit.densify(iteration):
                self._watch.set_back(iteration)

    def _look(self, iteration: int, loss: float) -> None:
        """Judge the views as they would be handed over now, and remember the state if it is the best."""
        began_s = time.monotonic()
        heldout = self._looks.take(self.fit.views(), iteration, loss, len(self.fit.optimiser.scene))
        if self._watch.note(heldout, iteration):
            self.best = self.fit.snapshot(iteration)
        self._pace.looked(time.monotonic() - began_s)

    def _figures(self) -> dict[str, float | int]:
        """Return what the last look found, for the display."""
        curve = self._looks.curve
        found = {"heldout": curve[-1].heldout, "psnr_db": curve[-1].psnr_db} if curve else {}
        known = {name: figure for name, figure in found.items() if figure is not None}
        return {**known, "gaussians": len(self.fit.optimiser.scene)}

    def _how_it_ran_away(self, iteration: int, loss: float) -> Finding | None:
        """Say what is wrong with the present iteration; None if it may be taken."""
        best = self.best.iteration
        if not self.fit.is_finite(loss):
            return finding(Code.ROLLED_BACK_NOT_FINITE, iteration=iteration, best=best)
        if self._first_loss is None:
            self._first_loss = loss
        if loss > EXPLODED * self._least_loss and loss > EXPLODED_SHARE_OF_FIRST * self._first_loss:
            least = self._least_loss
            return finding(Code.ROLLED_BACK_EXPLODED, iteration=iteration, best=best, least_loss=least, loss=loss)
        self._least_loss = min(self._least_loss, loss)
        return None

    def _roll_back(self, iteration: int, ran_away: Finding) -> bool:
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
        self.notes.append(ran_away)
        self._progress.say(ran_away.sentence)
        return True
