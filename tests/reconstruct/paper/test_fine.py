from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import first_gaussians
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.paper.fine import Fine, FineSettings, Pseudo, PseudoLoss, make_pseudo
from gs2ci.reconstruct.paper.perceptual import StructuralDissimilarity
from gs2ci.reconstruct.paper.pseudo_views import support_weights
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.gaussians import joined
from gs2ci.render.settings import RasterSettings
from tests.reconstruct.fit.plane_fits import fit_coarse

QUICK = FineSettings(iterations=40, damping=1.0, hold_out=HoldOut(share=0.05, look_every=10))


@dataclass
class Prior:
    """Answers with what a function makes of the pseudo-views, and remembers the question."""

    answer: object = lambda images: images
    name: str = "test"
    asked: list = field(default_factory=list)

    def __call__(self, question):
        self.asked.append(question)
        return self.answer(question.pseudo.images)


@pytest.fixture(scope="module")
def coarse(moving_plane):
    """A fit that has been stopped early, so that there is something left to refine."""
    shot, geometry = moving_plane
    holdout = Holdout.of(shot, 0.05, 0)
    renderer = ShotRenderer(shot, geometry.intrinsics, CpuBackend())
    fit = fit_coarse(
        FittedExposure(holdout, renderer, geometry),
        start=first_gaussians(seed_points(geometry, np.full((4, 32, 40, 3), 0.5, np.float32), 2)),
        settings=CoarseSettings(iterations=30, densify_every=100, hold_out=HoldOut(share=0.05, look_every=10)),
        seed=0,
        monitoring=Monitoring(),
    )
    return holdout, fit, renderer


def run(
    coarse,
    prior=None,
    settings=QUICK,
    *,
    distance=None,
    holdout=None,
    fit=None,
    renderer=None,
    score=None,
    loss=None,
    progress=None,
    halt=None,
):
    given_holdout, given_fit, given_renderer = coarse
    return Fine(settings, loss or LossWeights(), prior, distance or StructuralDissimilarity()).fit(
        holdout or given_holdout,
        fit or given_fit,
        renderer or given_renderer,
        0,
        Monitoring(progress=progress or Silent(), halt=halt or Halt()),
        score=score,
    )


class Halting(Silent):
    """Asks to halt at one step."""

    def __init__(self, at):
        super().__init__()
        self.at, self.halt, self.steps = at, Halt(), []
        self.halt.begin()

    def step(self, done, **figures):
        self.steps.append(done)
        if done == self.at:
            self.halt.ask()


def test_it_ends_where_it_is_asked_to_halt_and_keeps_what_it_has(coarse):
    listener = Halting(at=4)
    found = run(coarse, settings=replace(QUICK, gated=False), progress=listener, halt=listener.halt)
    # It ends with the iteration in which it sees the wish, after a look at what that made.
    assert listener.steps == [1, 2, 3, 4]
    assert found.curve[-1].iteration == coarse[1].curve[-1].iteration + 5
    assert found.views is not coarse[1].views


def test_the_held_out_residual_falls_and_cameras_stay(coarse):
    holdout, before, _ = coarse
    after = run(coarse, Prior())
    assert holdout.residual_rms(after.views) < holdout.residual_rms(before.views)
    np.testing.assert_array_equal(after.world_to_camera, before.world_to_camera)
    assert after.notes[-1].code is Code.FINE_HELPED
    assert after.curve[: len(before.curve)] == before.curve
    assert after.curve[-1].iteration > before.curve[-1].iteration


def test_the_same_seed_gives_the_same_scene(coarse):
    one, two = run(coarse, Prior()), run(coarse, Prior())
    assert torch.equal(one.scene.means, two.scene.means)
    np.testing.assert_array_equal(one.views, two.views)


def test_a_prior_draws_pseudo_views_towards_its_targets(coarse):
    """Targets that are darker than the scene darken the pseudo-views; a weight a hundred times the paper's shows it."""
    _, fit, renderer = coarse
    heavy = replace(QUICK, pseudo_weight=5.0, hold_out=replace(QUICK.hold_out, patience=1000))
    pseudo = make_pseudo(fit, renderer, Prior(), 1)
    lenient = Lenient(coarse[0].shot, coarse[0].pixels)
    after = run(coarse, Prior(lambda images: 0.5 * images), heavy, holdout=lenient)
    with torch.no_grad():
        images, _ = renderer.images(after.scene, pseudo.poses)
    assert images.mean() < 0.8 * pseudo.targets.mean()


class Lenient(Holdout):
    """Finds every look better than the one before."""

    def residual_rms_of(self, coded, added):
        self.looks = getattr(self, "looks", 0) + 1
        return 1 / self.looks


class Severe(Holdout):
    """Finds every look worse than the one before."""

    def residual_rms_of(self, coded, added):
        self.looks = getattr(self, "looks", 0) + 1
        return float(self.looks)


def test_what_held_out_pixels_do_not_like_is_dropped(coarse):
    holdout, before, _ = coarse
    after = run(coarse, Prior(), holdout=Severe(holdout.shot, holdout.pixels))
    assert after.scene is before.scene
    np.testing.assert_array_equal(after.views, before.views)
    assert "did not agree better" in after.notes[-1].sentence
    assert len(after.curve) > len(before.curve)


def test_a_prior_that_lies_cannot_make_the_held_out_residual_worse(coarse):
    holdout, before, _ = coarse
    noise = np.random.default_rng(0)
    liar = Prior(lambda images: noise.random(images.shape).astype(np.float32))
    after = run(coarse, liar, replace(QUICK, pseudo_weight=100.0))
    assert holdout.residual_rms(after.views) <= holdout.residual_rms(before.views)


@pytest.mark.parametrize("error", [NumericsError("its answer is NaN"), InputError("its size is another")])
def test_a_prior_that_fails_changes_nothing(coarse, error):
    def fail(images):
        raise error

    after = run(coarse, Prior(fail))
    assert after.scene is coarse[1].scene
    assert after.notes[-1] == finding(Code.FINE_UNCHANGED, why=error.problem)


def test_a_distance_that_fails_changes_nothing(coarse):
    @dataclass
    class Broken:
        name: str = "broken"

        def __call__(self, image, target):
            return image.sum() * float("nan")

    after = run(coarse, Prior(), distance=Broken())
    assert after.scene is coarse[1].scene
    assert "the distance broken of equal images is nan" in after.notes[-1].sentence


def test_without_held_out_pixels_nothing_is_changed(coarse):
    holdout, before, _ = coarse
    after = run(coarse, Prior(), holdout=Holdout(holdout.shot, np.zeros_like(holdout.pixels)))
    assert after.scene is before.scene
    assert "no pixel is held out" in after.notes[-1].sentence


def test_without_a_gate_the_last_state_is_taken_as_in_the_paper(coarse):
    holdout, before, _ = coarse
    blind = Holdout(holdout.shot, np.zeros_like(holdout.pixels))
    after = run(coarse, Prior(), replace(QUICK, gated=False), holdout=blind)
    assert after.curve[-1].iteration - before.curve[-1].iteration == 40
    assert not torch.equal(after.scene.means, before.scene.means)
    assert after.notes[-1] == finding(Code.FINE_UNJUDGED, with_prior="prior: test")
    severe = run(coarse, Prior(), replace(QUICK, gated=False), holdout=Severe(holdout.shot, holdout.pixels))
    assert not torch.equal(severe.scene.means, before.scene.means)


def test_the_terms_of_the_coarse_stage_stay(coarse):
    """A weight on opacity or size lowers it."""
    usual = run(coarse, None, replace(QUICK, gated=False)).scene
    fainter = run(coarse, None, replace(QUICK, gated=False), loss=LossWeights(opacity=1.0)).scene
    smaller = run(coarse, None, replace(QUICK, gated=False), loss=LossWeights(size=10.0)).scene
    assert fainter.opacity_logits.mean() < usual.opacity_logits.mean() - 0.1
    assert smaller.log_scales.mean() < usual.log_scales.mean() - 0.01


def test_gaussians_beyond_the_borders_of_all_views_stay_as_they_are(coarse):
    """No reading tells of them: the terms on opacity and size would make them fade and shrink."""
    _, before, _ = coarse
    scene = before.scene
    added = replace(scene.map(lambda tensor: tensor[:5].clone()), means=scene.means[:5] + torch.tensor([30.0, 0, 0]))
    outside = torch.arange(len(scene) + 5) >= len(scene)
    loss = LossWeights(opacity=1.0, size=1.0)
    fit = replace(before, scene=joined([scene, added]), outside=outside)
    after = run(coarse, Prior(), replace(QUICK, gated=False), fit=fit, loss=loss)
    for name, held in added.parameters().items():
        assert torch.equal(after.scene.parameters()[name][outside], held), name
    assert not torch.equal(after.scene.opacity_logits[~outside], scene.opacity_logits)
    assert torch.equal(after.outside, outside)


def test_one_camera_has_nothing_beside_its_path(coarse):
    _, before, _ = coarse
    single = replace(before, world_to_camera=before.world_to_camera[:1], views=before.views)
    after = run(coarse, Prior(), fit=single)
    assert after.scene is before.scene
    assert "there is only one camera" in after.notes[-1].sentence


def test_numbers_that_run_away_end_the_stage_with_the_last_good_state(coarse):
    class Faulty(ShotRenderer):
        """Gives gradients that are NaN from the 25th iteration on."""

        calls = 0

        def measurement_with_pull(self, *arguments):
            image, pull = super().measurement_with_pull(*arguments)

            def faulty(gradient):
                Faulty.calls += 1
                return pull(gradient * np.float32("nan" if Faulty.calls > 25 else 1))

            return image, faulty

    holdout, before, renderer = coarse
    faulty = Faulty(holdout.shot, renderer.intrinsics.double().numpy(), CpuBackend())
    after = run(coarse, Prior(), renderer=faulty)
    assert np.isfinite(after.views).all()
    assert after.curve[-1].iteration - before.curve[-1].iteration == 20
    assert holdout.residual_rms(after.views) < holdout.residual_rms(before.views)


def test_lists_kept_through_the_whole_stage_give_nearly_the_same_views(coarse, moving_plane):
    holdout, before, _ = coarse
    backend = CpuBackend(RasterSettings(relist_every=8))
    kept = run(coarse, None, renderer=ShotRenderer(holdout.shot, moving_plane[1].intrinsics, backend))
    fresh = run(coarse, None)
    assert not np.array_equal(kept.views, fresh.views)
    difference_rms = np.sqrt(np.mean((kept.views - fresh.views) ** 2))
    assert difference_rms < 0.1 * np.sqrt(np.mean((before.views - fresh.views) ** 2))


def test_without_a_prior_there_are_no_pseudo_views(coarse):
    after = run(coarse, None)
    assert "without a prior" in after.notes[-1].sentence
    weightless = run(coarse, Prior(), replace(QUICK, pseudo_weight=0.0))
    np.testing.assert_array_equal(after.views, weightless.views)


def test_the_score_is_told_at_each_look(coarse):
    after = run(coarse, None, score=lambda views: 12.5)
    assert {point.psnr_db for point in after.curve[len(coarse[1].curve) :]} == {12.5}


def test_a_prior_is_asked_about_views_between_and_beyond_the_cameras(coarse):
    _, fit, renderer = coarse
    prior = Prior()
    pseudo = make_pseudo(fit, renderer, prior, 1)
    (question,) = prior.asked
    assert question.pseudo.images.shape == (5, 32, 40, 3)
    assert question.recovered.images.shape == (4, 32, 40, 3)
    assert pseudo.alphas.shape == (5, 32, 40)
    np.testing.assert_allclose(question.recovered.images, fit.views, atol=1e-5)
    assert question.pseudo.depths.shape == (5, 32, 40)


def test_the_loss_on_a_pseudo_view_is_that_of_the_paper(coarse):
    """Eq. 10, written out."""
    generator = torch.Generator().manual_seed(3)
    image, target = torch.rand(2, 12, 16, 3, generator=generator, dtype=torch.float32)
    then, now = torch.rand(2, 12, 16, generator=generator)
    settings = FineSettings()
    distance = StructuralDissimilarity()
    loss = PseudoLoss(Pseudo(torch.eye(4)[None], target[None], then[None]), settings, distance)
    weights = support_weights(then, now, settings.support).double()
    photometric = (weights * (image - target).abs().mean(2)).sum() / weights.sum()
    wanted = 0.8 * float(photometric) + 0.01 * float(distance(image, target))
    assert float(loss(0, image, now)) == pytest.approx(wanted, rel=1e-5)


def test_settings_of_the_paper_are_the_default():
    settings = FineSettings()
    assert (settings.pseudo_weight, settings.l1, settings.perceptual) == (0.006, 0.8, 0.01)
    support = settings.support
    assert (support.threshold, support.softness, support.least) == (0.25, 0.08, 0.10)


@pytest.mark.parametrize(
    "part",
    [
        {"iterations": 0},
        {"between": -1},
        {"pseudo_weight": -1.0},
        {"l1": float("nan")},
        {"perceptual": float("inf")},
        {"damping": 0.0},
    ],
)
def test_settings_out_of_range_are_refused(part):
    with pytest.raises(InputError, match=f"{next(iter(part))} = .* in FineSettings"):
        FineSettings(**part).check()


def test_models_are_loaded_before_anything_is_done():
    assert FineSettings().load(LossWeights(), 0).prior is None
    with pytest.raises(InputError, match="prior 'dream'"):
        FineSettings(prior="dream").load(LossWeights(), 0)
    with pytest.raises(InputError, match="perceptual distance 'eye'"):
        FineSettings(distance="eye").load(LossWeights(), 0)
