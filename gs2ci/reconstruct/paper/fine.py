"""The fine stage: pseudo-views from beside the cameras are fitted to images of a frozen prior (paper, section III-D).

Here: the loss on pseudo-views (eqs. 10 and 11), the loop, and the gate: the result is kept only if it predicts the
held-out pixels at least as well as the coarse fit. Not here: the poses and weights (`pseudo_views`), the priors
(`priors2d`), the coarse stage.

The sum over all pseudo-views is estimated by one of them in each iteration; each is used once before any is used again.
The mean of this estimate is the paper's sum, at a fraction of the cost.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
import torch
from pydantic import Field, NonNegativeInt, PositiveInt
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import NotNegative
from gs2ci.core.errors import Gs2ciError, InputError, NumericsError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.fit.coarse.looks import Decode, LookedAt, Looks, Monitoring, Score, nothing
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut, Watch
from gs2ci.reconstruct.fit.losses.objective import DataTerm, LossWeights, add_regularisers
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.optimiser.poses import length_of
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.learned.onnx_models import known_model
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.paper.perceptual import PerceptualDistance, load_distance
from gs2ci.reconstruct.paper.priors2d.base import ImagePrior, Question, SeenViews
from gs2ci.reconstruct.paper.priors2d.choose import load_prior
from gs2ci.reconstruct.paper.pseudo_views import SupportSettings, support_weights, synthesised_poses
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class FineSettings(Bounded):
    """The schedule and the weights of the fine stage. The weights are the paper's (section IV-A).

    Args:
        prior: Makes the target images of pseudo-views: "difix", "onnx:FILE" or "difix-or-none" (`priors2d.choose`);
            "none" skips pseudo-views.
        distance: The perceptual term: "structure"; "lpips" or "lpips:FILE" if the user has such a model;
            "lpips-or-structure".
        iterations: At most so many. The paper has 3000; the coarse stage's schedule is shortened by the same factor.
        steps: Step sizes: the literature's, which are small; that of the means after a third of its schedule.
        damping: Factor on all of them: a new Adam steps at full size whatever the gradient.
        between: Pseudo-views between each two cameras.
        pseudo_weight: Of all pseudo-views together, λ_syn.
        l1: Of their ℓ1 term.
        perceptual: Of their perceptual term.
        support: Weight of their pixels.
        hold_out: How long the stage waits for the held-out residual to improve.
        gated: Whether the held-out residual decides which state is kept; if not, it is the last one, as in the paper.
    """

    prior: str = "none"
    distance: str = "structure"
    iterations: PositiveInt = 300
    steps: StepSizes = field(
        default_factory=lambda: replace(
            StepSizes.of_the_literature(), means=3.2e-5, means_final_share=1.0, colours=2.5e-3
        )
    )
    damping: Annotated[float, Field(gt=0, le=1)] = 0.3
    between: NonNegativeInt = 1
    pseudo_weight: NotNegative = 0.006
    l1: NotNegative = 0.8
    perceptual: NotNegative = 0.01
    support: SupportSettings = field(default_factory=SupportSettings)
    hold_out: HoldOut = field(default_factory=HoldOut)
    gated: bool = True

    @classmethod
    def of_the_paper(cls, coarse: StepSizes) -> "FineSettings":
        """Return the stage as in the paper: 3,000 iterations, the last state kept, whatever its held-out residual.

        Args:
            coarse: Step sizes of the coarse stage. The paper does not state those of the fine stage. We continue with
                the means' step at the end of the coarse stage, and with the constant steps of all others.
        """
        iterations = 3000
        means = coarse.means * coarse.means_final_share
        return cls(
            prior="difix-or-none",
            distance="lpips-or-structure",
            iterations=iterations,
            steps=replace(coarse, means=means, means_final_share=1.0),
            damping=1.0,
            hold_out=HoldOut(share=0.0, look_every=100, patience=iterations, growth_patience=iterations),
            gated=False,
        )

    def load(self, loss: LossWeights, seed: int) -> "Fine":
        """Load what the settings name; see `LastStageSettings`."""
        self.check()
        prior = load_prior(self.prior, seed)
        distance = load_distance(self.distance)
        notes = []
        if self.prior == "difix-or-none" and prior is None:
            notes.append(finding(Code.STAND_IN, absent="DiFix3D+", instead="no prior"))
        if self.distance == "lpips-or-structure" and known_model("lpips") is None:
            notes.append(finding(Code.STAND_IN, absent="LPIPS", instead=distance.name))
        return Fine(self, loss, prior, distance, tuple(notes))

    def with_models(self, prior: str | None, distance: str | None) -> "FineSettings":
        """Return the same with another prior or distance, by name; None: as it is."""
        return replace(self, prior=prior or self.prior, distance=distance or self.distance)


@dataclass(frozen=True)
class Fine:
    """A fine stage ready to run: its settings with the models that they name.

    Args:
        settings: The schedule and the weights.
        loss: Weights of the terms kept from the coarse stage.
        prior: Makes the targets; None skips pseudo-views.
        distance: The perceptual term.
        notes: Findings about substitutes for models of the paper that have not been added.
    """

    settings: FineSettings
    loss: LossWeights
    prior: ImagePrior | None
    distance: PerceptualDistance
    notes: Findings = ()

    def fit(
        self,
        holdout: Holdout,
        coarse: CoarseFit,
        renderer: ShotRenderer,
        seed: int,
        monitoring: Monitoring,
        decode: Decode = nothing,
        score: Score | None = None,
    ) -> CoarseFit:
        """Refine the Gaussians of a coarse fit with fixed cameras.

        Args:
            holdout: The measurement (its truth is not read), and its pixels that the loss may not see.
            coarse: The fit to continue.
            renderer: Renders for this shot.
            seed: For the order of the pseudo-views.
            monitoring: What is called at looks and iterations, and what may interrupt.
            decode: Its result is added to the scene's views at looks, as before delivery.
            score: Turns refined views into a figure for the curve; it may know the truth.

        Returns:
            The state with the smallest held-out residual; the coarse fit if no state is better, if no pixel is held
            out, or if the prior or the distance fails. A note says which.
        """
        settings = self.settings.check()
        progress = monitoring.progress
        coded = holdout.coded(coarse.views)
        before = holdout.residual_rms_of(coded, decode(coded))
        if before is None and settings.gated:
            return _unchanged(coarse, "no pixel is held out to tell whether it helps", progress)
        try:
            pseudo_loss = _pseudo_loss(coarse, renderer, self)
        except Gs2ciError as error:
            return _unchanged(coarse, error.problem, progress)
        fit = _Fit(holdout, coarse, renderer, pseudo_loss, self, seed)
        looks = Looks(monitoring.since_s)

        def look(iteration: int, loss: float) -> float | None:
            # Numbered after those of the coarse stage.
            at = iteration + (coarse.curve[-1].iteration if coarse.curve else 0)
            judged = LookedAt(holdout, decode, fit.coded(), fit.views, score)
            return looks.take([judged], at, loss, len(fit.optimiser.scene))

        best, after = fit.iterate(before, look, monitoring)
        curve = (*coarse.curve, *looks.curve)
        if best is None:
            kept = _unchanged(coarse, "held-out pixels did not agree better with anything it made", progress)
            return replace(kept, curve=curve)
        named = "without a prior" if self.prior is None else f"prior: {self.prior.name}"
        if before is not None and after is not None and settings.gated:
            note = finding(Code.FINE_HELPED, with_prior=named, before=before, after=after)
        else:
            note = finding(Code.FINE_UNJUDGED, with_prior=named)
        for said in (*self.notes, note):
            progress.say(said.sentence)
        return replace(
            coarse,
            scene=best,
            views=renderer.exposed(best, fit.poses),
            curve=curve,
            notes=(*coarse.notes, *self.notes, note),
        )


@dataclass(frozen=True)
class Pseudo:
    """Pseudo-views and their target images.

    Args:
        poses: World to camera, [V, 4, 4] float32.
        targets: [V, H, W, 3] float32.
        alphas: When the targets were made, [V, H, W] float32.
    """

    poses: Tensor
    targets: Tensor
    alphas: Tensor


@dataclass(frozen=True)
class PseudoLoss:
    """λ_l1 Σ W |X − X̂| / Σ W + λ_per D_per(X, X̂) of one pseudo-view (eq. 10)."""

    pseudo: Pseudo
    settings: FineSettings
    distance: PerceptualDistance

    def __call__(self, view: int, image: Tensor, alpha: Tensor) -> Tensor:
        """Return the loss of a rendered view, [H, W, 3] with alpha [H, W], as a differentiable scalar."""
        target = self.pseudo.targets[view]
        weights = support_weights(self.pseudo.alphas[view], alpha, self.settings.support)
        error = (image - target).abs().mean(dim=2)
        # ε of eq. 10 keeps the mean defined if no pixel has any weight; weights sum to thousands.
        photometric = (weights * error).sum() / (weights.sum() + 1e-6)
        loss = self.settings.l1 * photometric
        if self.settings.perceptual:
            loss = loss + self.settings.perceptual * self.distance(image, target)
        return loss


def _pseudo_loss(coarse: CoarseFit, renderer: ShotRenderer, fine: Fine) -> PseudoLoss | None:
    """Prepare the loss on pseudo-views; None if they are skipped.

    Raises:
        Gs2ciError: The prior or the distance failed, or there is only one camera.
    """
    if fine.prior is None or fine.settings.pseudo_weight == 0:
        return None
    pseudo = make_pseudo(coarse, renderer, fine.prior, fine.settings.between)
    if not len(pseudo.poses):
        raise InputError("there is only one camera, and no path for pseudo-views")
    loss = PseudoLoss(pseudo, fine.settings, fine.distance)
    first = loss(0, pseudo.targets[0], pseudo.alphas[0])
    if not torch.isfinite(first):
        raise NumericsError(f"the distance {fine.distance.name} of equal images is {float(first)}")
    return loss


def make_pseudo(coarse: CoarseFit, renderer: ShotRenderer, prior: ImagePrior, between: int) -> Pseudo:
    """Render pseudo-views of a scene and make their targets by the prior.

    Args:
        coarse: The scene and its path.
        renderer: Renders for the shot.
        prior: Makes the targets.
        between: Pseudo-views between two neighbours.

    Raises:
        Gs2ciError: The prior failed.
    """
    poses = synthesised_poses(coarse.world_to_camera, between)
    at = torch.from_numpy(poses).float()
    if not len(poses):
        return Pseudo(at, torch.empty(0), torch.empty(0))
    with torch.no_grad():
        images, alphas = renderer.images(coarse.scene, at)
        cameras = torch.from_numpy(coarse.world_to_camera).float()
        recovered, _ = renderer.images(coarse.scene, cameras)
    question = Question(
        pseudo=SeenViews(images.numpy(), renderer.depths(coarse.scene, poses), poses),
        recovered=SeenViews(
            recovered.numpy(), renderer.depths(coarse.scene, coarse.world_to_camera), coarse.world_to_camera
        ),
        intrinsics=renderer.intrinsics.double().numpy(),
        distortion=renderer.distortion,
    )
    return Pseudo(at, torch.from_numpy(prior(question)), alphas)


def _unchanged(coarse: CoarseFit, why: str, progress: Progress) -> CoarseFit:
    note = finding(Code.FINE_UNCHANGED, why=why)
    progress.say(note.sentence)
    return replace(coarse, notes=(*coarse.notes, note))


class _Fit:
    """The Gaussians being refined, and the gradients on them."""

    def __init__(
        self,
        holdout: Holdout,
        coarse: CoarseFit,
        renderer: ShotRenderer,
        pseudo_loss: PseudoLoss | None,
        fine: Fine,
        seed: int,
    ) -> None:
        shot = holdout.shot
        self.settings = settings = fine.settings
        self._loss = fine.loss
        self.poses = torch.from_numpy(coarse.world_to_camera).float()
        self.optimiser = GaussianOptimiser(
            coarse.scene, settings.steps, length_of(settings.steps.unit, coarse.world_to_camera)
        )
        self._outside = coarse.outside
        self._renderer = renderer
        self._reuse = renderer.reuse()  # this stage neither adds nor removes Gaussians
        self._pseudo_loss = pseudo_loss
        self._data_term = DataTerm(shot.measurement, ~holdout.pixels, shot.saturated, fine.loss, renderer.exposure)
        views = 0 if pseudo_loss is None else len(pseudo_loss.pseudo.poses)
        self._order = _rounds(views, torch.Generator().manual_seed(seed))

    def backward(self) -> float:
        """Accumulate the gradients of the objective (eq. 11); return the loss."""
        scene = self.optimiser.scene
        predicted, pull = self._renderer.measurement_with_pull(scene, self.poses, self._reuse)
        value, gradient = self._data_term.value_and_gradient(np.asarray(predicted))
        pull(gradient)
        if self._pseudo_loss is not None:
            view = next(self._order)
            images, alphas = self._renderer.images(scene, self._pseudo_loss.pseudo.poses[view : view + 1])
            loss = self.settings.pseudo_weight * self._pseudo_loss(view, images[0], alphas[0])
            loss.backward()  # type: ignore[no-untyped-call]
            value += float(loss.detach())
        return value + float(add_regularisers(scene, self._loss))

    def coded(self) -> F32:
        """Render the measurement as the scene predicts it, [H, W, C]."""
        return self._renderer.measurement(self.optimiser.scene, self.poses).numpy()

    def views(self) -> F32:
        """Render the scene as each mask saw it."""
        return self._renderer.exposed(self.optimiser.scene, self.poses)

    def iterate(
        self, before: float | None, look: Callable[[int, float], float | None], monitoring: Monitoring
    ) -> tuple[Gaussians | None, float | None]:
        """Step, look and stop.

        Args:
            before: The held-out residual at the start.
            look: Takes a look after so many iterations with such a loss, and returns the held-out residual.
            monitoring: What is called at iterations, and what may interrupt.

        Returns:
            The best Gaussians, None if none were better than at the start, and the smallest held-out residual.
        """
        settings, progress = self.settings, monitoring.progress
        watch = Watch(settings.hold_out)
        found: Gaussians | None = None
        best = before if settings.gated else None
        if best is not None:
            watch.note(best, 0)
        progress.stage("fine fit", settings.iterations)
        for iteration in range(1, settings.iterations + 1):
            loss = self.backward()
            if not (np.isfinite(loss) and self.optimiser.gradient_is_finite()):
                break
            # Steps grow from small to full: Adam's first ones would be of full size whatever the gradient.
            warm = min(1.0, iteration / settings.hold_out.look_every)
            if self._outside is not None:  # those beyond the borders of all views stay as they are
                self.optimiser.hold(self._outside)
            self.optimiser.step(iteration / settings.iterations, settings.damping * warm)
            halted = monitoring.halt.asked
            if iteration % settings.hold_out.look_every == 0 or iteration == settings.iterations or halted:
                residual = look(iteration, loss)
                if watch.note(residual if settings.gated else None, iteration):
                    best, found = residual, self.optimiser.scene.map(lambda tensor: tensor.detach().clone())
                if halted or watch.stalled(iteration):
                    break
            progress.step(iteration, loss=loss)
        return found, best


def _rounds(count: int, generator: torch.Generator) -> Iterator[int]:
    """Yield each of `count` views once in random order, repeatedly."""
    while True:
        yield from torch.randperm(count, generator=generator).tolist()
