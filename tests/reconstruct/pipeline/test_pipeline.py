"""The whole reconstruction: what it returns, that it repeats, and settings that it refuses."""

import sys
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gs2ci.core import kernels
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.core.records import Truth
from gs2ci.core.run_figures import EnsembleSection
from gs2ci.core.run_records import SECONDS_KEYS
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import GeometrySettings
from gs2ci.reconstruct.geometry.tracks.tracks import TrackSettings
from gs2ci.reconstruct.hypotheses import fitting
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings
from tests.reconstruct.pipeline.boards import BRIEF, HEIGHT, QUICK, SHORT, VIEWS, WIDTH, expose

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found(shot):
    return reconstruct(shot, QUICK)


@pytest.fixture(scope="module")
def briefly(shot):
    """A reconstruction, and what it compiled that is not declared."""

    def compiled_for():
        return {(one, types) for _, one, _ in kernels_of_the_product() for types in one.signatures}

    before = compiled_for()
    found = reconstruct(shot, BRIEF)
    declared = {(one, types) for _, one, types in kernels_of_the_product()}
    return found, [(one.__name__, types) for one, types in compiled_for() - before - declared]


@pytest.fixture(scope="module")
def found_briefly(briefly):
    return briefly[0]


def assert_same_bits(first, second):
    for name in ("views", "scene_views", "decode", "depth", "world_to_camera", "predicted_measurement"):
        np.testing.assert_array_equal(getattr(first.result, name), getattr(second.result, name), err_msg=name)
    for name, tensor in first.scene.parameters().items():
        assert torch.equal(tensor, second.scene.parameters()[name]), name
    rows = [[(p.iteration, p.loss, p.heldout, p.gaussians) for p in found.result.curve] for found in (first, second)]
    assert rows[0] == rows[1]
    assert first.result.heldout_rms == second.result.heldout_rms


def test_it_beats_its_own_decode(shot, found):
    result, truth = found.result, shot.truth.views
    assert result.geometry.verdict == "full"
    assert 0 < result.geometry.path_error_expected < 0.2
    assert result.verdict in ("refined", "scene")
    assert result.heldout_rms[result.verdict] < 0.8 * result.heldout_rms["decode"]
    assert np.mean(psnr_per_view(result.views, truth)) > np.mean(psnr_per_view(result.decode, truth)) + 3


def test_growth_of_the_population_is_not_taken_for_an_explosion(found):
    assert Code.ROLLED_BACK_EXPLODED not in [note.code for note in found.result.notes]


def test_the_near_board_is_found_nearer_than_the_wall(found):
    depth = found.result.depth[VIEWS // 2]
    assert np.median(depth[16:32, 24:40]) < 0.6 * np.median(depth[:, :10])


def test_the_result_is_whole(shot, found):
    result = found.result.check()
    assert result.views.shape == result.scene_views.shape == result.decode.shape == (VIEWS, HEIGHT, WIDTH, 3)
    assert set(result.seconds) == {*SECONDS_KEYS, "registration", "uncertainty"}
    parts = (*SECONDS_KEYS[1:], "registration", "uncertainty")
    assert result.seconds["total"] == pytest.approx(sum(result.seconds[key] for key in parts))
    assert result.curve[0].seconds > result.seconds["decode"]
    assert len(found.scene) == result.gaussians
    assert set(result.heldout_rms) == {"refined", "scene", "decode"}
    assert result.seed == QUICK.seed
    assert result.settings["fit"]["iterations"] == 160
    predicted = (shot.masks[..., None] * result.views).sum(axis=0)
    np.testing.assert_allclose(result.predicted_measurement, predicted, atol=1e-5)


def test_neither_truth_nor_standard_errors_nor_threads_change_a_bit(shot, found_briefly):
    """The other run had all threads that this process may take: one beside others, two or more alone."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("Numba was started with one thread")
    before = numba.get_num_threads(), torch.get_num_threads()
    count = 1 if before[0] > 1 else 2
    try:
        numba.set_num_threads(count)
        torch.set_num_threads(count)
        other = reconstruct(replace(shot, truth=Truth()), replace(BRIEF, uncertainty=False))
    finally:
        numba.set_num_threads(before[0])
        torch.set_num_threads(before[1])
    assert found_briefly.result.uncertainty is not None
    assert other.result.uncertainty is None
    assert_same_bits(other, found_briefly)


def test_most_values_lie_within_two_standard_errors_and_err_more_where_these_are_larger(shot, found):
    errors, off = found.result.uncertainty, np.abs(found.result.views - shot.truth.views)
    assert 0.5 < np.mean(off < errors.views[..., None]) < 0.97
    assert np.mean(off < 2 * errors.views[..., None]) > 0.85
    unsure = errors.views > np.median(errors.views)
    assert off[unsure].mean() > 1.3 * off[~unsure].mean()
    assert np.array_equal(errors.depth > 0, found.result.depth > 0)


def test_kernels_are_called_with_the_types_that_they_declare(briefly):
    """Else `gs2ci compile` compiles what nobody calls, and the first call compiles once more."""
    assert briefly[1] == []


def kernels_of_the_product():
    modules = [name for name in tuple(sys.modules) if name.startswith("gs2ci")]
    return [(module, *each) for module in modules for each in kernels.declared(module)]


def test_the_mean_of_two_fits_is_nearer_the_truth_than_the_first_alone(shot):
    """On average: of one seed the first fit may be the better one by half a decibel."""
    gained = []
    for seed in (0, 1, 2):
        # Patches may make good for what one fit lacks.
        settings = replace(QUICK, seed=seed, fit=replace(QUICK.fit, iterations=100), polish=None)
        one, two = (reconstruct(shot, replace(settings, fits=fits)).result for fits in (1, 2))
        one_db, two_db = (np.mean(psnr_per_view(run.views, shot.truth.views)) for run in (one, two))
        gained.append(two_db - one_db)
    assert np.mean(gained) > 0


def test_one_curve_leads_to_the_mean_of_two_fits(shot, found):
    two = reconstruct(shot, SHORT, score=lambda views: float(np.mean(views))).result
    assert two.ensemble.fits == two.ensemble.averaged == 2
    assert 0 < two.ensemble.spread < 0.1
    assert found.result.ensemble == EnsembleSection(1, 1, None)
    # Its last point is what is handed over.
    *course, last = two.curve
    assert last.iteration == course[-1].iteration
    assert last.heldout == two.heldout_rms["refined"]
    assert last.psnr_db == pytest.approx(np.mean(two.views))
    assert last.seconds >= course[-1].seconds


def test_a_fit_that_is_missing_from_the_mean_is_told(shot, monkeypatch):
    started = []

    class EverySecondFails(fitting.CoarseRun):
        def __init__(self, **arguments):
            super().__init__(**arguments)
            started.append(arguments["seed"])

        def advance(self, share=1.0, progress=None):
            if self in companions:
                raise NumericsError("the first iteration of the fit is not finite")
            super().advance(share, progress)

    companions, enter = [], fitting.Fits.enter

    def watched(self, *arguments):
        entrant = enter(self, *arguments)
        companions.extend([entrant.run] if entrant.hypothesis.member else [])
        return entrant

    monkeypatch.setattr(fitting.Fits, "enter", watched)
    monkeypatch.setattr(fitting, "CoarseRun", EverySecondFails)
    result = reconstruct(shot, BRIEF).result
    assert len(started) == 2
    assert result.ensemble == EnsembleSection(1, 1, None)
    assert result.disagreement is None
    assert finding(Code.FITS_MISSING, fits=1, of=2) in result.notes


@pytest.mark.parametrize("fits", [0, -1, 65])
def test_a_number_of_fits_that_makes_no_sense_is_refused(shot, fits):
    with pytest.raises(InputError, match=f"fits = {fits} in Settings"):
        reconstruct(shot, replace(QUICK, fits=fits))


def test_a_density_rule_that_is_named_is_that_of_every_fit():
    settings = Settings()
    assert [rule.name for rule in settings.density_rules] == ["osgr", "osgr"]
    assert settings.with_density_rule("osgr") is settings
    assert [rule.name for rule in settings.with_density_rule("mcmc").density_rules] == ["mcmc"]
    with pytest.raises(InputError, match="no density rule 'abc'"):
        settings.with_density_rule("abc")


def test_torch_is_kept_on_one_thread_and_given_its_threads_back(shot):
    """More threads change the last bits of its sums, for scenes larger than these tests can afford."""

    class Listener(Silent):
        def step(self, done, **figures):
            assert torch.get_num_threads() == 1

    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        reconstruct(shot, replace(QUICK, fit=replace(QUICK.fit, iterations=1)), Listener())
        assert torch.get_num_threads() == 2
        with pytest.raises(InputError):
            reconstruct(shot, Settings(seed=-1))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_another_seed_holds_other_pixels_out(shot, found):
    other = reconstruct(shot, replace(QUICK, seed=2, fit=replace(QUICK.fit, iterations=20)))
    assert other.result.heldout_rms["decode"] != found.result.heldout_rms["decode"]


def test_every_stage_and_look_is_told(shot):
    class Listener(Silent):
        def __init__(self):
            super().__init__()
            self.stages = []

        def stage(self, name, total=None):
            self.stages.append((name, total))

    listener = Listener()
    looks = []
    settings = replace(QUICK, fit=replace(QUICK.fit, iterations=40))
    result = reconstruct(shot, settings, listener, lambda views: looks.append(views.shape) or 12.5).result
    assert [name for name, _ in listener.stages] == ["registration", "decode", "geometry", "fit", "fit", "views"]
    assert listener.stages[-3:] == [("fit", 40), ("fit", 40), ("views", None)]
    assert looks == [(VIEWS, HEIGHT, WIDTH, 3)] * 2
    assert [point.psnr_db for point in result.curve] == [12.5, 12.5]


def test_a_wrong_scene_loses_against_the_decode_and_the_decode_is_kept(shot):
    """Views that have nothing in common, a fit of one step: no scene explains them."""
    rng = np.random.default_rng(7)
    unrelated = gaussian_filter(rng.random((VIEWS, HEIGHT, WIDTH, 3)), (0, 3, 3, 0)).astype(np.float32)
    unrelated = (unrelated - unrelated.min()) / np.ptp(unrelated)
    settings = replace(
        QUICK,
        fit=replace(QUICK.fit, iterations=1),
        residual=GapTvSettings(iterations=1, weight=1.0),
    )
    result = reconstruct(expose(unrelated), settings).result
    assert result.verdict == "decode"
    np.testing.assert_array_equal(result.views, result.decode)
    assert (result.scene_views != result.decode).any()
    # Nothing is left to judge: the pixels that were held out are explained as well as all others.
    coded = (shot.masks[..., None] * result.views).sum(axis=0)
    left = ((coded - expose(unrelated).measurement) ** 2).mean()
    assert np.sqrt(left) < 0.5 * result.heldout_rms["decode"]


def test_what_is_handed_over_foretells_held_out_pixels_better_than_the_decode_and_the_scene(found):
    known = found.result.heldout_rms
    assert found.result.verdict == "refined"
    assert known["refined"] < min(known["scene"], known["decode"])


def test_with_nothing_held_out_the_scene_is_taken_and_a_note_says_that_nothing_judged(shot):
    hold_out = replace(QUICK.fit.hold_out, share=0.0)
    settings = replace(QUICK, fit=replace(QUICK.fit, iterations=20, hold_out=hold_out))
    result = reconstruct(shot, settings).result
    assert result.verdict == "scene"
    assert set(result.heldout_rms.values()) == {None}
    assert finding(Code.UNJUDGED) in result.notes


@pytest.mark.parametrize(
    "settings",
    [
        Settings(seed=-1),
        Settings(seed=2**63),
        Settings(stride_px=0),
        Settings(backend="abacus"),
        Settings(poses="lidar"),
        Settings(poses="file:absent.json"),
        Settings(poses="vggt:absent.onnx"),
        Settings(proxy="oracle"),
        Settings(decode=GapTvSettings(iterations=0)),
        Settings(residual=GapTvSettings(weight=-1.0)),
        Settings(fit=CoarseSettings(iterations=0)),
        Settings(fine=FineSettings(iterations=0)),
        Settings(fine=FineSettings(prior="onnx:absent.onnx")),
        Settings(fit=CoarseSettings(hold_out=HoldOut(share=float("nan")))),
        Settings(fit=CoarseSettings(loss=LossWeights(window_px=10))),
        Settings(geometry=GeometrySettings(sweep=SweepSettings(window_px=6))),
        Settings(geometry=GeometrySettings(tracks=TrackSettings(window_px=20))),
        Settings(raster=RasterSettings(relist_every=0)),
    ],
)
def test_settings_that_make_no_sense_are_refused_before_any_work(shot, settings):
    class Listener(Silent):
        def stage(self, name, total=None):
            raise AssertionError(f"stage {name} began")

    with pytest.raises(InputError):
        reconstruct(shot, settings, Listener())


def test_what_the_renderer_may_leave_out_is_a_setting_and_in_the_record(shot):
    short = replace(SHORT, fits=1, fit=replace(SHORT.fit, iterations=10))
    plain = reconstruct(shot, short).result
    for raster in (RasterSettings(relist_every=1), RasterSettings(termination_transmittance=0.05)):
        result = reconstruct(shot, replace(short, raster=raster)).result
        assert result.settings["raster"]["relist_every"] == raster.relist_every
        assert not np.array_equal(result.scene_views, plain.scene_views)
        assert np.abs(result.scene_views - plain.scene_views).mean() < 0.02


def test_a_shot_that_contradicts_itself_is_refused(shot):
    with pytest.raises(InputError, match="masks"):
        reconstruct(replace(shot, masks=shot.masks[:, :-1]))


def test_the_fine_stage_follows_the_coarse_one_when_it_is_asked_for(shot, found_soon):
    fine = FineSettings(iterations=20, hold_out=HoldOut(look_every=10))
    with_fine = reconstruct(shot, replace(SHORT, fine=fine)).result
    without = found_soon.result
    assert with_fine.curve[-1].iteration == 60 + 20
    assert with_fine.seconds["fine"] > 0
    assert sum(v for k, v in with_fine.seconds.items() if k != "total") == pytest.approx(with_fine.seconds["total"])
    assert any(note.sentence.startswith("The fine stage") for note in with_fine.notes)
    assert with_fine.settings["fine"]["prior"] == "none"
    # The stage is judged before patches, which polish the delivered views and leave both alike.
    note = next(note for note in with_fine.notes if note.code is Code.FINE_HELPED)
    assert note.figures["after"] < note.figures["before"]
    assert with_fine.heldout_rms["scene"] < without.heldout_rms["scene"]
    assert with_fine.heldout_rms["refined"] < 1.05 * without.heldout_rms["refined"]
    assert "fine" not in without.seconds
