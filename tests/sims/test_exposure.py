"""The exposure against what physics says: energy, noise, blur; and its promises to the reader of a shot."""

import dataclasses

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.lens import pixels_of, slopes_of, undistorted
from gs2ci.core.storage import read_shot, write_shots
from gs2ci.reconstruct.fit.scene.mask_moments import stated_within_mask
from gs2ci_sims.effects.base import LightStage
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.photons import Dust, GhostReflection
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.exposure import Studio, calibrated_masks, read_out
from gs2ci_sims.light_path import EffectChain, generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.radiance import Renderer, rendered_depth
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.sensor import SensorFigures
from tests.exposing import expose

SENSOR = SensorFigures()
STILL = StageMove((0.0, 0.0, 0.0))
PHOTONS = 4000.0


@pytest.fixture(scope="module")
def masks(small_scene):
    return random_masks(4, small_scene.size, 0.25, generator(0, "masks"))


@pytest.fixture(scope="module")
def moving(small_scene):
    return stage_move_for_parallax(small_scene, 6.0, Timing().duration_s(4))


def rig_for(masks, photons=PHOTONS, **parts):
    return RigFigures(light=Light(photons), modulator=ModulatorFigures(masks=len(masks)), sensor=SENSOR, **parts)


def shoot(scene, path, masks, effects=(), *, photons=PHOTONS, seed=3, timing=None, **options):
    rig = rig_for(masks, photons, timing=timing or Timing())
    return expose(scene, path, masks, rig, effects=effects, seed=seed, **options)


def coded(shot):
    return (shot.masks[..., None] * shot.truth.views).sum(axis=0)


def test_without_effects_and_motion_the_measurement_is_the_sum_of_the_masked_views(small_scene, masks):
    shot = shoot(small_scene, STILL, masks)
    np.testing.assert_allclose(shot.measurement, coded(shot), atol=1e-5)


def test_open_masks_over_a_scene_at_rest_collect_one_view_per_mask(small_scene, masks):
    shot = shoot(small_scene, STILL, np.ones_like(masks))
    np.testing.assert_allclose(shot.measurement, 4 * shot.truth.views[0], atol=1e-5)


def test_closed_masks_let_no_light_through(small_scene, masks):
    half_closed = masks * (np.arange(64) < 32)
    measurement = shoot(small_scene, STILL, half_closed.astype(np.float32)).measurement
    assert not measurement[:, 32:].any()
    assert measurement[:, :32].any()


def test_sub_exposures_add_up_to_the_light_of_the_whole_interval(small_scene, moving, masks):
    shot = shoot(small_scene, moving, masks, [MotionBlur(8)])
    many = np.linspace(0, 1, 97)[1::2]
    intervals = Timing().intervals_s(4)
    expected = 0.0
    for mask, (start, stop) in zip(masks, intervals, strict=True):
        views = Renderer().views(small_scene, moving.world_to_camera(start + (stop - start) * many))[0]
        expected = expected + mask[..., None] * views.mean(axis=0, dtype=np.float64)
    np.testing.assert_allclose(shot.measurement, expected, atol=8e-3)
    assert np.sqrt(np.square(shot.measurement - expected).mean()) < 1e-3


def test_motion_blur_converges_as_it_is_sampled_more_finely(small_scene, moving, masks):
    by_nodes = {n: shoot(small_scene, moving, masks, [MotionBlur(n)]).measurement for n in (1, 2, 4, 16)}
    off = shoot(small_scene, moving, masks).measurement
    errors = [np.abs(by_nodes[n] - by_nodes[16]).mean() for n in (1, 2, 4)]
    assert np.array_equal(off, by_nodes[1])
    assert errors[0] > 4 * errors[1] > 16 * errors[2] > 0


def test_a_moving_camera_blurs_what_the_solvers_model_takes_as_sharp(small_scene, moving, masks):
    shot = shoot(small_scene, moving, masks, [MotionBlur(8)])
    assert np.abs(shot.measurement - coded(shot)).mean() > 1e-3
    assert shot.measurement.sum() == pytest.approx(coded(shot).sum(), rel=0.01)


def test_the_noise_of_a_shot_is_that_of_its_electrons(small_scene, masks):
    clean = shoot(small_scene, STILL, masks).measurement
    noise = shoot(small_scene, STILL, masks, sensor_effects(SENSOR)).measurement - clean
    full_scale_e = PHOTONS * SENSOR.quantum_efficiency
    variance_e = clean * full_scale_e + SENSOR.read_noise_e**2 + SENSOR.electrons_per_dn**2 / 12
    normalised = noise * full_scale_e / np.sqrt(variance_e)
    assert normalised.std() == pytest.approx(1.0, rel=0.03)
    assert abs(normalised.mean()) < 0.05


def test_the_truth_holds_poses_and_views_at_the_centre_of_each_interval(small_scene, moving, masks):
    shot = shoot(small_scene, moving, masks, [MotionBlur(3), *sensor_effects(SENSOR)])
    poses = moving.world_to_camera(Timing().intervals_s(4).mean(axis=1))
    assert np.array_equal(shot.truth.world_to_camera, poses)
    assert np.array_equal(shot.truth.views, Renderer().views(small_scene, poses)[0])
    for depth, pose in zip(shot.truth.depth, poses, strict=True):
        there = rendered_depth(small_scene.gaussians, pose, small_scene.intrinsics, small_scene.size)
        assert np.array_equal(depth, np.nan_to_num(there).astype(np.float32))
        assert (depth > 0).mean() > 0.9
    assert shot.weights.tolist() == pytest.approx([1.0] * 4)


@pytest.mark.parametrize("k1", [-0.2, 0.2])
def test_behind_a_lens_the_true_views_are_bent_and_the_shot_says_how(small_scene, masks, k1):
    lens = LensDistortion(k1, 0.01)
    shot, straight = (shoot(small_scene, STILL, masks, effects) for effects in ([lens], []))
    assert shot.distortion.tolist() == [k1, 0.01, 0, 0, 0]
    assert straight.distortion is None
    np.testing.assert_allclose(shot.measurement, coded(shot), atol=1e-5)
    assert np.abs(shot.truth.views - straight.truth.views).mean() > 0.01
    # A straight edge of depth bends as the views do: compared where the lens says that the light came from.
    rows, columns = np.clip(lens.sources_px(small_scene.size, small_scene.intrinsics), 0, None).astype(int)
    inside = (rows < small_scene.size[0]) & (columns < small_scene.size[1])
    unbent = straight.truth.depth[0][
        np.minimum(rows, small_scene.size[0] - 1), np.minimum(columns, small_scene.size[1] - 1)
    ]
    close = np.abs(shot.truth.depth[0] / unbent - 1) < 0.02
    assert close[inside].mean() > 0.95
    # In the middle nothing moves.
    middle = np.s_[:, 23:25, 31:33]
    np.testing.assert_allclose(shot.truth.views[middle], straight.truth.views[middle], atol=0.02)


def test_the_coefficients_written_are_those_of_the_formula_that_solvers_know(small_scene):
    """Two programs of one formula: the simulator's own inverts the radius alone."""
    lens, camera, size = LensDistortion(-0.2, 0.03), small_scene.intrinsics, small_scene.size
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    slopes = slopes_of(np.stack([columns, rows], axis=-1), camera)
    places = pixels_of(undistorted(slopes, lens.coefficients), camera)
    np.testing.assert_allclose(lens.sources_px(size, camera), places.transpose(2, 0, 1)[::-1], rtol=0, atol=1e-9)


def test_rounding_never_makes_less_than_no_light(small_scene, masks, monkeypatch):
    """Weights that cancel may leave -1e-16 of a photon, of which no square root can be taken."""
    monkeypatch.setattr("gs2ci_sims.exposure._open_share", lambda *_: np.full(small_scene.size, -1e-16))
    shot = shoot(small_scene, STILL, masks, [MotionBlur(3), LensDistortion(-0.2), *sensor_effects(SENSOR)])
    assert np.isfinite(shot.measurement).all()


@pytest.mark.parametrize("blur_px", [0.0, 5.0, 12.0, 40.0])
def test_a_ghost_however_blurred_leaves_dark_pixels_without_light(small_scene, masks, blur_px):
    """From 11 pixels on OpenCV convolves by a Fourier transform, whose rounding is negative beside the light."""
    spot = np.zeros_like(masks)
    spot[:, 4:12, 4:12] = 1
    shot = shoot(small_scene, STILL, spot, [GhostReflection(0.05, blur_px), *sensor_effects(SENSOR)])
    assert np.isfinite(shot.measurement).all()


def test_readings_that_are_not_finite_are_refused():
    photons = np.full((4, 5, 1), 100.0)
    photons[2, 3] = np.nan
    with pytest.raises(NumericsError, match=r"1 simulated readings are not finite, through the effects .*read_noise"):
        read_out(photons, EffectChain(sensor_effects(SENSOR), 0))
    with pytest.raises(NumericsError, match="through the effects none"):
        read_out(photons, EffectChain((), 0))


@pytest.mark.parametrize("effect", [GhostReflection(0.3, 3.0), Dust(40.0, 3.0, 5.0)], ids=["ghost", "dust"])
def test_behind_a_ghost_or_dust_the_masks_of_a_shot_add_up_to_what_an_even_field_measures(small_scene, masks, effect):
    shot = shoot(small_scene, STILL, masks, [effect])
    even = masks.sum(axis=0, dtype=np.float64)[..., None]
    opened = np.ones((*small_scene.size, 1))
    seen, field = (effect.apply(light, RigFigures(), generator(0, effect.name)) for light in (even, opened))
    np.testing.assert_allclose(shot.masks.sum(axis=0), (seen / max(field.max(), 1))[..., 0], atol=1e-5)


def test_the_unit_of_a_measurement_grows_with_the_light_that_a_ghost_adds(small_scene, masks):
    plain, ghosted = (shoot(small_scene, STILL, masks, effects) for effects in ((), [GhostReflection(0.3, 3.0)]))
    assert ghosted.measurement.sum() == pytest.approx(plain.measurement.sum(), rel=1e-5)


@pytest.mark.parametrize("effect", [GhostReflection(0.3, 3.0), Dust(40.0, 3.0, 5.0)], ids=["ghost", "dust"])
def test_masks_are_calibrated_against_the_open_field_behind_the_same_ghost_or_dust(small_scene, masks, effect):
    chain = EffectChain([effect], 0)
    opened = np.ones((*small_scene.size, 1))
    lit = chain.through(LightStage.PHOTONS, opened)[..., 0] > 0
    found = calibrated_masks(np.stack([*masks, opened[..., 0]]), chain)
    np.testing.assert_allclose(found[-1], lit, rtol=1e-6)
    if isinstance(effect, Dust):
        np.testing.assert_allclose(found[:-1], masks * lit, atol=1e-6)


def test_the_same_seed_gives_the_same_shot_and_another_seed_another(small_scene, moving, masks):
    first, again, other = (
        shoot(small_scene, moving, masks, sensor_effects(SENSOR), seed=seed).measurement for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_pixels_that_reached_the_full_well_are_marked_and_read_at_least_that(small_scene, masks):
    shot = shoot(small_scene, STILL, np.ones_like(masks), sensor_effects(SENSOR), photons=8000.0)
    full_scale_e = 8000.0 * SENSOR.quantum_efficiency
    truly = 4 * shot.truth.views[0] * full_scale_e > SENSOR.full_well_e + 5 * SENSOR.full_well_e**0.5
    assert 0.05 < shot.saturated.mean() < 1
    assert shot.saturated[truly.any(axis=2)].all()
    assert shot.measurement.max() <= (SENSOR.full_well_e + 6 * SENSOR.read_noise_e) / full_scale_e


@pytest.mark.parametrize("photons", [1e-3, 1e9])
def test_extreme_light_levels_stay_finite(small_scene, masks, photons):
    shot = shoot(small_scene, STILL, masks, sensor_effects(SENSOR), photons=photons)
    assert np.isfinite(shot.measurement).all()


def test_dark_gaps_lengthen_the_move_but_not_the_light():
    timing = Timing(interval_s=0.1, dark_s=0.05)
    intervals = timing.intervals_s(4)
    assert timing.duration_s(4) == pytest.approx(intervals[-1, 1] - intervals[0, 0]) == pytest.approx(0.55)
    np.testing.assert_allclose(intervals[:, 1] - intervals[:, 0], 0.1)
    np.testing.assert_allclose(intervals[1:, 0] - intervals[:-1, 1], 0.05)
    assert intervals.mean() == pytest.approx(0.0, abs=1e-12)


def test_one_mask_and_many_masks_are_exposed(small_scene):
    for count in (1, 32):
        shot = shoot(small_scene, STILL, random_masks(count, small_scene.size, 0.5, generator(0, "masks")))
        assert shot.views == count


def test_a_shot_survives_its_file(small_scene, moving, masks, tmp_path):
    shot = shoot(small_scene, moving, masks, [MotionBlur(2), *sensor_effects(SENSOR)])
    back = read_shot(write_shots(tmp_path / "shot.h5", [shot]))
    for name in ("measurement", "masks", "weights", "saturated", "intrinsics"):
        assert np.array_equal(getattr(back, name), getattr(shot, name)), name
    assert np.array_equal(back.truth.views, shot.truth.views)
    assert np.array_equal(back.truth.depth, shot.truth.depth)


@pytest.mark.parametrize(("effects", "stated"), [
    ([], "still"),
    ([MotionBlur(1)], "still"),
    ([MotionBlur(2)], "moving"),
    ([MotionBlur(1, edges_s=(0.0, 1e-3))], "moving"),
])  # fmt: skip
def test_a_shot_states_whether_light_was_integrated_along_the_path(small_scene, moving, masks, effects, stated):
    assert stated_within_mask(shoot(small_scene, moving, masks, effects)) == stated


def test_masks_of_another_size_are_refused(small_scene, masks):
    with pytest.raises(InputError, match="masks of shape"):
        shoot(small_scene, STILL, masks[:, :-1])


@pytest.mark.parametrize("photons", [-1.0, float("nan"), float("inf")])
def test_a_light_level_without_meaning_is_refused(small_scene, masks, photons):
    with pytest.raises(InputError, match=r"full_scale_photons = .* in Light"):
        shoot(small_scene, STILL, masks, photons=photons)


@pytest.mark.parametrize("timing", [{"interval_s": 0.0}, {"dark_s": -0.1}])
def test_a_timing_without_meaning_is_refused(timing):
    with pytest.raises(InputError, match=r"_s = .* in Timing"):
        Timing(**timing)


def test_a_scene_seen_from_another_reference_pose_gives_the_same_shot(small_scene, masks):
    turned = np.array([[0, 0, -1, 0.3], [0, 1, 0, 0], [1, 0, 0, 2.0], [0, 0, 0, 1.0]])
    gaussians = small_scene.gaussians
    view = StageMove((0.0, 0.0, 0.0), reference_world_to_camera=turned)
    elsewhere = dataclasses.replace(small_scene, gaussians=gaussians, world_to_camera=turned)
    assert not np.array_equal(shoot(elsewhere, view, masks).measurement, shoot(small_scene, STILL, masks).measurement)


def test_masks_of_another_number_than_the_rig_shows_are_refused(small_scene, masks):
    with pytest.raises(InputError, match="3 masks on a rig that shows 4"):
        expose(small_scene, STILL, masks[:3], rig_for(masks), effects=[], seed=0)


def test_the_true_depth_before_a_camera_at_rest_is_sought_once(monkeypatch, small_scene, masks, moving):
    sought = []
    found = Studio.depth
    monkeypatch.setattr(Studio, "depth", lambda self, time_s: sought.append(time_s) or found(self, time_s))
    still = shoot(small_scene, STILL, masks, (MotionBlur(1),))
    assert len(sought) == 1
    assert np.array_equal(still.truth.depth[0], still.truth.depth[3])
    sought.clear()
    shoot(small_scene, moving, masks, (MotionBlur(1),))
    assert len(sought) == 4
