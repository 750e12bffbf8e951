"""All effects of sensor and readout together where light, sizes and settings are extreme: finite, in range."""

import dataclasses

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.render.ply import write_ply
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, Persistence
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu, ReadNoise, RowNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity
from gs2ci_sims.effects.timing import RollingShutter
from gs2ci_sims.light_path import LIGHT_PATH, EffectChain, sensor_effects
from gs2ci_sims.path import StageMove
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.ply import scene_from_ply
from gs2ci_sims.sensor import SensorFigures
from tests.exposing import expose

STILL = StageMove((0.0, 0.0, 0.0))
MILD = (
    RollingShutter(1e-5), BayerFilter("GRBG"), Prnu(0.01), DarkCurrent(5.0), HotPixels(0.01, 500.0),
    Persistence(0.01, 1.0, 0.1, 5000.0), Blooming(0.3), GainNonlinearity(0.01), Dsnu(1.0), RowNoise(1.0),
    BlackLevel(2.0),
)  # fmt: skip
EXTREME = (
    RollingShutter(1e-2), BayerFilter("BGGR"), Prnu(0.5), DarkCurrent(1e12, 100.0), HotPixels(1.0, 1e12),
    Persistence(1.0, 1e-9, 0.0, 1e12), Blooming(1.0), GainNonlinearity(-0.249), Dsnu(1e5), RowNoise(1e5),
    BlackLevel(-1e5),
)  # fmt: skip


def shoot(scene, count=2, effects=MILD, photons=4000.0, open_share=0.5, sensor=None, seed=0):
    sensor = sensor or SensorFigures()
    rig = RigFigures(Light(photons), modulator=ModulatorFigures(count), timing=Timing(0.01), sensor=sensor)
    masks = (np.random.default_rng(1).random((count, *scene.size)) < open_share).astype(np.float32)
    masks[0, 0, 0] = 1.0
    return expose(scene, STILL, masks, rig, effects=(*effects, *sensor_effects(sensor)), seed=seed), rig


def readings(shot, rig):
    return shot.measurement.astype(float) * (rig.full_scale_e or 1.0) * rig.dn_per_e + rig.sensor.black_level_dn


@pytest.mark.parametrize("effects", [(), MILD, EXTREME], ids=["none", "mild", "extreme"])
@pytest.mark.parametrize("photons", [0.0, 1e-6, 4000.0, 1e9])
def test_readings_are_finite_and_within_the_converters_range(small_scene, photons, effects):
    shot, rig = shoot(small_scene, photons=photons, effects=effects)
    assert np.isfinite(shot.measurement).all()
    dn = readings(shot, rig)
    assert -0.01 <= dn.min() <= dn.max() <= 2**rig.sensor.bits - 1 + 0.01


def test_without_light_the_readings_are_black_and_dark_noise():
    shot, rig = shoot(planes(np.random.default_rng(0), (60, 80)), photons=0.0, effects=())
    dn = readings(shot, rig)
    assert dn.mean() == pytest.approx(rig.sensor.black_level_dn, abs=0.05)
    assert not shot.saturated.any()


def test_where_everything_saturates_everything_is_marked(small_scene):
    shot, rig = shoot(small_scene, photons=1e9, open_share=1.0, effects=(Blooming(1.0),))
    assert shot.saturated.all()
    assert readings(shot, rig).std() < 3 * rig.sensor.read_noise_e * rig.dn_per_e


def test_thirty_two_masks_and_a_sensor_of_one_pixel_are_measured_like_others(small_scene):
    shot, _ = shoot(small_scene, count=32)
    assert shot.views == 32
    one = planes(np.random.default_rng(0), (1, 1))
    assert shoot(one)[0].size == (1, 1)
    assert shoot(one, effects=EXTREME)[0].size == (1, 1)


def test_a_bayer_sensor_gives_a_mosaic_and_says_which(small_scene):
    shot, _ = shoot(small_scene)
    assert shot.cfa == "GRBG"
    assert shot.measurement.shape == (*small_scene.size, 1)
    assert shot.channels == 3
    assert shoot(small_scene, effects=())[0].cfa is None


ADDING = (DarkCurrent(5.0), HotPixels(0.3, 500.0), Dsnu(1.0), ReadNoise(2.0), RowNoise(1.0))


@pytest.mark.parametrize("left_out", ADDING, ids=lambda effect: effect.name)
def test_leaving_one_effect_out_changes_no_draw_of_the_others(left_out):
    charge = np.full((6, 5, 3), 50.0)
    every, rest, alone = (
        EffectChain(effects, 3).through(left_out.stage, charge)
        for effects in (ADDING, [effect for effect in ADDING if effect is not left_out], [left_out])
    )
    np.testing.assert_allclose(every - rest, alone - charge, atol=1e-9)


def test_every_effect_has_a_name_of_its_own():
    assert len({kind.name for kind in LIGHT_PATH}) == len(LIGHT_PATH)


def test_the_same_seed_gives_the_same_reading_and_another_one_another(small_scene):
    first, again, other = (shoot(small_scene, seed=seed)[0].measurement for seed in (4, 4, 5))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_an_empty_scene_is_refused_before_anything_is_simulated(small_scene, tmp_path):
    path = write_ply(tmp_path / "empty.ply", small_scene.gaussians.map(lambda tensor: tensor[:0]))
    with pytest.raises(InputError, match="nothing in front"):
        scene_from_ply(path, (8, 8))


def test_a_scene_behind_the_camera_is_refused_before_anything_is_simulated(small_scene):
    with pytest.raises(InputError, match="nothing in front"):
        dataclasses.replace(small_scene, depth=-small_scene.depth)
