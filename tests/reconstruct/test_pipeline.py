import itertools
import json
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.core.run_records import SECONDS_KEYS
from gs2ci.evaluate.cameras import nerfstudio_transforms
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.attempts import choice, fits
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings
from gs2ci.reconstruct.decode.residual import ResidualSettings
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.fine import FineSettings
from gs2ci.reconstruct.fit.losses import LossWeights
from gs2ci.reconstruct.fit.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.fit.stopping import HoldOut
from gs2ci.reconstruct.geometry.initialise import GeometrySettings
from gs2ci.reconstruct.geometry.sweep import SweepSettings
from gs2ci.reconstruct.geometry.tracks import TrackSettings
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings

pytestmark = pytest.mark.slow

VIEWS, HEIGHT, WIDTH = 6, 48, 64
FOCAL_PX = 60.0
QUICK = Settings(
    fit=CoarseSettings(iterations=160, densify_every=25, hold_out=HoldOut(look_every=20)),
    fits=1,
    poses="tracks",
    look_again=False,
    motion="off",
    try_orders=False,
    seed=1,
)
SHORT = replace(QUICK, fit=replace(QUICK.fit, iterations=60, densify_every=20), fits=2)
# Long enough for a look, and for a population that changed: what bits are compared needs no more.
BRIEF = replace(SHORT, fit=replace(SHORT.fit, iterations=24, densify_every=8))


def wall_with_a_board(channels=3, wall_px=0.4, board_px=1.6):
    """Views [N, H, W, C] of a far wall and a near board before it, from a camera that moves sideways.

    From view to view the wall shifts by `wall_px` and the board by `board_px`.
    """
    rng = np.random.default_rng(4)
    margin, x, y = 16, np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float)

    def texture():
        noise = gaussian_filter(rng.random((HEIGHT, WIDTH + 2 * margin, channels)), (2, 2, 0))
        return (noise - noise.min()) / np.ptp(noise)

    wall, board, views = texture(), texture(), []
    for i in range(VIEWS):
        move = i - (VIEWS - 1) / 2
        layers = [
            np.stack(
                [
                    map_coordinates(layer[..., c], np.meshgrid(y, x + margin + step * move, indexing="ij"), order=1)
                    for c in range(channels)
                ],
                axis=-1,
            )
            for layer, step in ((wall, wall_px), (board, board_px))
        ]
        place = x + board_px * move
        on_board = ((place > 18) & (place < 46))[None, :] & ((y > 12) & (y < 36))[:, None]
        views.append(np.where(on_board[..., None], layers[1], layers[0]))
    return np.stack(views).astype(np.float32)


def expose(views, masks=None, **parts):
    if masks is None:
        masks = (np.random.default_rng(5).random(views.shape[:3]) < 0.35).astype(np.float32)
    camera = np.array([[FOCAL_PX, 0, WIDTH / 2], [0, FOCAL_PX, HEIGHT / 2], [0, 0, 1]])
    shot = Shot(
        measurement=(masks[..., None] * views).sum(axis=0),
        masks=masks,
        weights=np.ones(len(views), np.float32),
        intrinsics=camera,
        truth=Truth(views=views),
    )
    return replace(shot, **parts).check()


@pytest.fixture(scope="module")
def shot():
    return expose(wall_with_a_board())


@pytest.fixture(scope="module")
def found(shot):
    return reconstruct(shot, QUICK)


@pytest.fixture(scope="module")
def found_soon(shot):
    return reconstruct(shot, SHORT)


@pytest.fixture(scope="module")
def found_briefly(shot):
    return reconstruct(shot, BRIEF)


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
    assert result.geometry["verdict"] == "full"
    assert 0 < result.geometry["path_error_expected"] < 0.2
    assert result.verdict in ("refined", "scene")
    assert result.heldout_rms[result.verdict] < 0.8 * result.heldout_rms["decode"]
    assert np.mean(psnr_per_view(result.views, truth)) > np.mean(psnr_per_view(result.decode, truth)) + 3


def test_growth_of_the_population_is_not_taken_for_an_explosion(found):
    assert Code.ROLLED_BACK_EXPLODED not in [note.code for note in found.result.notes]


def test_dead_rows_are_left_out_and_cost_little(shot, found_soon):
    measurement = shot.measurement.copy()
    measurement[8:40:4] = 0
    result = reconstruct(replace(shot, measurement=measurement), SHORT).result
    unpolished = reconstruct(replace(shot, measurement=measurement), replace(SHORT, polish=None)).result
    assert any("8 of 48 rows read one value throughout" in note.sentence for note in result.notes)
    whole, damaged, before = (
        np.mean(psnr_per_view(r.views, shot.truth.views)) for r in (found_soon.result, result, unpolished)
    )
    # Patches gain most where all rows are there.
    assert damaged > whole - 5
    assert damaged > before - 0.2


def test_the_near_board_is_found_nearer_than_the_wall(found):
    depth = found.result.depth[VIEWS // 2]
    assert np.median(depth[16:32, 24:40]) < 0.6 * np.median(depth[:, :10])


def test_the_result_is_whole(shot, found):
    result = found.result.check()
    assert result.views.shape == result.scene_views.shape == result.decode.shape == (VIEWS, HEIGHT, WIDTH, 3)
    assert set(result.seconds) == {*SECONDS_KEYS, "registration"}
    parts = (*SECONDS_KEYS[1:], "registration")
    assert result.seconds["total"] == pytest.approx(sum(result.seconds[key] for key in parts))
    assert result.curve[0].seconds > result.seconds["decode"]
    assert len(found.scene) == result.gaussians
    assert set(result.heldout_rms) == {"refined", "scene", "decode"}
    assert result.seed == QUICK.seed
    assert result.settings["fit"]["iterations"] == 160
    predicted = (shot.masks[..., None] * result.views).sum(axis=0)
    np.testing.assert_allclose(result.predicted_measurement, predicted, atol=1e-5)


def test_the_truth_is_not_read(shot, found_briefly):
    assert_same_bits(reconstruct(replace(shot, truth=Truth()), BRIEF), found_briefly)


def test_the_same_seed_gives_the_same_bits_on_one_thread_and_on_two(shot, found_briefly):
    """The other run had all that this process may take: one beside others, two or more alone."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("Numba was started with one thread")
    before = numba.get_num_threads(), torch.get_num_threads()
    count = 1 if before[0] > 1 else 2
    try:
        numba.set_num_threads(count)
        torch.set_num_threads(count)
        assert_same_bits(reconstruct(shot, BRIEF), found_briefly)
    finally:
        numba.set_num_threads(before[0])
        torch.set_num_threads(before[1])


def test_fits_side_by_side_give_the_same_bits_as_in_turn(shot, found_briefly, monkeypatch):
    monkeypatch.setattr(numba, "threading_layer", lambda: "workqueue")
    assert_same_bits(reconstruct(shot, BRIEF), found_briefly)


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
    assert two.ensemble["fits"] == two.ensemble["averaged"] == 2
    assert 0 < two.ensemble["spread"] < 0.1
    assert found.result.ensemble == {"fits": 1, "averaged": 1, "spread": None}
    # Its last point is what is handed over.
    *course, last = two.curve
    assert last.iteration == course[-1].iteration
    assert last.heldout == two.heldout_rms["refined"]
    assert last.psnr_db == pytest.approx(np.mean(two.views))
    assert last.seconds >= course[-1].seconds


def test_a_fit_that_is_missing_from_the_mean_is_told(shot, monkeypatch):
    whole, started = fits.fit_coarse, []

    def every_second_fails(**arguments):
        started.append(arguments["seed"])
        if arguments["seed"] != BRIEF.seed:
            raise NumericsError("the first iteration of the fit is not finite")
        return whole(**arguments)

    monkeypatch.setattr(fits, "fit_coarse", every_second_fails)
    result = reconstruct(shot, BRIEF).result
    assert len(started) == 2
    assert result.ensemble == {"fits": 1, "averaged": 1, "spread": None}
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
    assert [name for name, _ in listener.stages] == ["registration", "decode", "geometry", "fit"]
    assert listener.stages[-1] == ("fit", 40)
    assert looks == [(VIEWS, HEIGHT, WIDTH, 3)] * 2
    assert [point.psnr_db for point in result.curve] == [12.5, 12.5]


def test_grey_masks_and_unequal_weights_are_part_of_the_model():
    views = wall_with_a_board()
    rng = np.random.default_rng(6)
    masks = np.clip((rng.random(views.shape[:3]) < 0.35) * rng.uniform(0.5, 1, views.shape[:3]), 0, 1).astype("f4")
    weights = rng.uniform(0.7, 1, VIEWS).astype(np.float32)
    coded = (weights[:, None, None, None] * masks[..., None] * views).sum(axis=0)
    result = reconstruct(expose(views, masks, weights=weights, measurement=coded), QUICK).result
    assert result.heldout_rms[result.verdict] < 0.8 * result.heldout_rms["decode"]
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views)) + 3


def test_a_mono_measurement_gives_mono_views_better_than_their_decode():
    views = wall_with_a_board(channels=1)
    result = reconstruct(expose(views), QUICK).result
    assert result.views.shape == (VIEWS, HEIGHT, WIDTH, 1)
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views)) + 3


def test_a_mosaic_gives_colour_views_better_than_their_decode():
    views = wall_with_a_board()
    shot = expose(views)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    channel = rows % 2 + columns % 2  # RGGB: red where both are even, blue where both are odd
    mosaic = np.take_along_axis(shot.measurement, channel[..., None], axis=2)
    result = reconstruct(replace(shot, measurement=mosaic, cfa="RGGB").check(), QUICK).result
    assert result.views.shape == (VIEWS, HEIGHT, WIDTH, 3)
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views))


def test_a_wrong_scene_loses_against_the_decode_and_the_decode_is_kept(shot):
    """Views that have nothing in common, a fit of one step: no scene explains them."""
    rng = np.random.default_rng(7)
    unrelated = gaussian_filter(rng.random((VIEWS, HEIGHT, WIDTH, 3)), (0, 3, 3, 0)).astype(np.float32)
    unrelated = (unrelated - unrelated.min()) / np.ptp(unrelated)
    settings = replace(
        QUICK,
        fit=replace(QUICK.fit, iterations=1),
        residual=ResidualSettings(iterations=1, weight=1.0),
    )
    result = reconstruct(expose(unrelated), settings).result
    assert result.verdict == "decode"
    np.testing.assert_array_equal(result.views, result.decode)
    assert (result.scene_views != result.decode).any()
    # Nothing is left to judge: the pixels that were held out are explained as well as all others.
    coded = (shot.masks[..., None] * result.views).sum(axis=0)
    left = ((coded - expose(unrelated).measurement) ** 2).mean()
    assert np.sqrt(left) < 0.5 * result.heldout_rms["decode"]


def test_a_lamp_that_flickers_is_told_of_once_and_in_the_predicted_measurement(shot):
    told = replace(shot, weights=np.array([1.3, 0.8, 1.2, 0.7, 1.3, 0.9], np.float32))
    hold_out = HoldOut(share=0.1, look_every=20)
    result = reconstruct(told, replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))).result
    lit = told.weights * np.array(result.brightness)
    np.testing.assert_allclose(lit / lit.mean(), 1, atol=0.1)
    assert len([note for note in result.notes if note.code is Code.WEIGHTS_CORRECTED]) == 1
    exact = np.einsum("n,nhw,nhwc->hwc", lit, told.masks, result.views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)


def test_masks_of_a_camera_that_goes_on_have_moments_and_the_views_show_the_middle_of_each(shot):
    hold_out = HoldOut(share=0.1, look_every=20)
    settings = replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))
    listener = Silent()
    moving = replace(settings, mask_moments=MaskMomentSettings("moving", tolerance=1e-4, most=2))
    result = reconstruct(shot, moving, listener).result
    assert result.mask_moments["moments"] == [2] * VIEWS
    assert next(note.sentence for note in result.notes if note.code is Code.MASKS_HAVE_MOMENTS) in listener.sentences
    exact = np.einsum("nhw,nhwc->hwc", shot.masks, result.exposed_views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)
    # The middle of a mask is sharper than the mean over it.
    sharp, meant = (np.abs(np.diff(views, axis=2)).mean() for views in (result.views, result.exposed_views))
    assert sharp > meant
    assert (result.scene_views != result.exposed_views).any()
    settled = reconstruct(shot, replace(settings, mask_moments=MaskMomentSettings("still", tolerance=1e-4))).result
    assert settled.mask_moments is None
    assert settled.exposed_views is None


def test_views_of_uneven_light_stay_as_they_were_seen_where_weights_tell_nothing(shot):
    light = np.array([1.3, 0.8, 1.2, 0.7, 1.3, 0.7], np.float32)
    lit = (shot.truth.views * light[:, None, None, None]).astype(np.float32)
    exposed = replace(expose(lit), truth=Truth(views=lit))
    hold_out = HoldOut(share=0.1, look_every=20)
    settings = replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))
    result = reconstruct(exposed, settings, score=lambda views: float(np.mean(psnr_per_view(views, lit)))).result
    assert result.brightness is None
    assert result.light["views"] == "as-seen"
    used = np.array(result.light["used"])
    np.testing.assert_allclose(used / used.mean(), light / light.mean(), atol=0.1)
    for views in (result.views, result.scene_views, result.decode):
        seen = views.mean(axis=(1, 2, 3))
        np.testing.assert_allclose(seen / lit.mean(axis=(1, 2, 3)), 1, atol=0.15)
    exact = np.einsum("nhw,nhwc->hwc", exposed.masks, result.views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)
    assert result.curve[-1].psnr_db > np.mean(psnr_per_view(result.decode, lit)) - 1


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
        Settings(residual=ResidualSettings(weight=-1.0)),
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
    assert with_fine.settings["fine"]["prior"] == "consistent"
    assert with_fine.heldout_rms["refined"] <= without.heldout_rms["refined"]
    assert "fine" not in without.seconds


def test_the_geometry_may_come_from_a_camera_file_found_in_proxy_views(shot, tmp_path):
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = -np.arange(VIEWS) / FOCAL_PX  # a camera that moves to the right
    camera_file = tmp_path / "transforms.json"
    camera_file.write_text(json.dumps(nerfstudio_transforms(poses, shot.intrinsics, shot.size)))
    settings = replace(SHORT, poses=f"file:{camera_file}", proxy="eni", fit=replace(SHORT.fit, iterations=1))
    result = reconstruct(shot, settings).result
    assert result.geometry["asked_for"] == f"file:{camera_file}"
    assert (result.geometry["method"], result.geometry["proxy"]) == ("file", "eni")
    assert any("moved the poses of the file" in note.sentence for note in result.notes)


def test_a_stage_that_reports_millimetres_gives_path_and_depth_in_millimetres():
    """Of 60 px focal length: from step to step the board shifts by 2 px and the wall by 1 px.

    Tracks of so few pixels fall short of the shifts, so that depths are 4 to 11 % too large; between processors and
    seeds they differ by 2 % (docs/processors.md).
    """
    step_mm = 2.0
    shot = expose(wall_with_a_board(wall_px=1.0, board_px=2.0))
    told = np.tile(np.eye(4), (VIEWS, 1, 1))
    told[:, 0, 3] = -step_mm * np.arange(VIEWS)
    result = reconstruct(replace(shot, telemetry_world_to_camera=told), replace(QUICK, poses="auto")).result
    assert (result.geometry["method"], result.geometry["unit_of"]) == ("stage", "stage")
    length_mm = np.linalg.norm(np.ptp(np.linalg.inv(result.world_to_camera)[:, :3, 3], axis=0))
    assert length_mm == pytest.approx(step_mm * (VIEWS - 1), rel=0.1)
    depth_mm = result.depth[VIEWS // 2]
    assert np.median(depth_mm[16:32, 24:40]) == pytest.approx(step_mm * FOCAL_PX / 2.0, rel=0.2)
    assert np.median(depth_mm[:8]) == pytest.approx(step_mm * FOCAL_PX / 1.0, rel=0.2)


def test_without_poses_that_were_given_lengths_have_no_unit(found_soon):
    assert found_soon.result.geometry["unit_of"] is None


def test_poses_that_the_views_do_not_bear_out_are_said_to_be_left_out(shot):
    """Not that the fit hardly moved them."""
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1, VIEWS)
    dark = replace(shot, measurement=np.zeros_like(shot.measurement), telemetry_world_to_camera=poses)
    settings = replace(SHORT, poses="stage", fit=replace(SHORT.fit, iterations=1))
    notes = [note.sentence for note in reconstruct(dark, settings).result.notes]
    assert any("poses of the stage were not used" in note for note in notes)
    assert not any("moved the poses" in note for note in notes)


def test_a_second_look_is_handed_over_where_held_out_pixels_prefer_it(shot, found_soon):
    """Every path is doubtful by this criterion; the first attempt is that of `found_soon`."""
    strict = replace(SHORT.geometry, criteria=replace(SHORT.geometry.criteria, path_error=0.0))
    again = reconstruct(shot, replace(SHORT, look_again=True, geometry=strict)).result
    before, after = (one.heldout_rms["scene"] for one in (found_soon.result, again))
    assert after <= before
    assert (finding(Code.PATH_FOUND_AGAIN) in again.notes) == (after < before)
    assert again.geometry["path_error_expected"] == found_soon.result.geometry["path_error_expected"]


@pytest.mark.parametrize("joins", [True, False])
def test_views_that_join_in_part_are_matched_again_before_any_fit(shot, monkeypatch, joins):
    def again(first, *_):
        return replace(first, geometry=replace(first.geometry, source="wide")) if joins else None

    monkeypatch.setattr(pipeline, "joins_in_part", lambda _: True)
    monkeypatch.setattr(pipeline, "look_far_apart", again)
    settings = replace(BRIEF, look_again=True, fits=1)
    assert reconstruct(shot, settings).result.geometry["method"] == ("wide" if joins else "tracks")


def test_a_budget_leaves_no_time_for_a_second_look(shot, monkeypatch):
    monkeypatch.setattr(choice, "second_look", lambda *_: pytest.fail("looked again"))
    strict = replace(SHORT.geometry, criteria=replace(SHORT.geometry.criteria, path_error=0.0))
    settings = replace(SHORT, look_again=True, geometry=strict)
    # A clock that goes on by two seconds whenever it is read: some forty iterations.
    budget = Budget(100.0, 0.0, lambda preset: replace(preset, fits=1), itertools.count(0.0, 2.0).__next__)
    assert reconstruct(shot, settings, budget=budget).result.views.shape == shot.truth.views.shape


def test_a_choice_by_evidence_is_explained_in_the_notes(shot):
    still = replace(shot, telemetry_world_to_camera=np.tile(np.eye(4), (VIEWS, 1, 1)))
    result = reconstruct(still, replace(SHORT, poses="auto", fit=replace(SHORT.fit, iterations=1))).result
    method = result.geometry["method"]
    assert result.geometry["asked_for"] == "auto"
    assert method in ("tracks", "uniform")
    said = [note.sentence for note in result.notes]
    begins = f"Geometry from {method}. Residual of each source that was tried: the stage failed"
    assert any(note.startswith(begins) for note in said)
