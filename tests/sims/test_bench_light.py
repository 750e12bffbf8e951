import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.bench_light import BenchLight
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.masks import MaskEdges
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.stage import StageVibration
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.world import MaskInterval, World

SIZE = (40, 60)


def make(**options):
    scene = planes(np.random.default_rng(1), SIZE)
    options = {"full_scale_e_per_s": 50_000.0, "noise": False} | options
    light = BenchLight(scene, SensorFigures(), MaskAlignment(2, 10, 20), **options)
    world = World(light)
    return light, world


def expose(world, levels, seconds=0.02, bits=12):
    start_s = world.clock.now_s()
    world.show_mask(levels)
    world.clock.sleep_s(seconds)
    return world.integrate(start_s, start_s + seconds, height=SIZE[0], width=SIZE[1], bits=bits)


def test_a_fully_open_modulator_gives_the_scenes_radiance_in_dn():
    light, world = make()
    reading = expose(world, np.ones((100, 160), np.uint8))
    views, poses = light.truth(world.exposures[0])
    expected = 64.0 + views[0, ..., 0] * 50_000 * 0.02 / 2.7
    assert reading == pytest.approx(expected, abs=1.0)
    assert np.array_equal(poses[0], world.world_to_camera_at(0.0))


def test_a_full_well_given_as_an_effect_is_the_sensors():
    light, _ = make(effects=[FullWell(5000.0)])
    assert light.sensor.full_well_e == light.nominal_rig(12).sensor.full_well_e == 5000.0


def test_a_dark_modulator_gives_the_black_level():
    _, world = make()
    start_s = world.clock.now_s()
    world.clock.sleep_s(0.02)
    reading = world.integrate(start_s, start_s + 0.02, height=SIZE[0], width=SIZE[1], bits=12)
    assert (reading == 64).all()


def test_light_grows_with_the_share_of_open_mirrors_in_a_superpixel():
    _, world = make()
    full = expose(world, np.ones((100, 160), np.uint8)).astype(float)
    half = np.zeros((100, 160), np.uint8)
    half[::2] = 1
    assert expose(world, half) - 64.0 == pytest.approx((full - 64.0) / 2, abs=1.0)


def test_fewer_bits_are_the_same_light_on_a_coarser_scale():
    _, world = make()
    fine = expose(world, np.ones((100, 160), np.uint8)).astype(float)
    coarse = expose(world, np.ones((100, 160), np.uint8), bits=8).astype(float)
    assert coarse * 16 == pytest.approx(fine, abs=9.0)


def test_a_mosaic_takes_one_colour_at_each_pixel():
    light, world = make(cfa="RGGB")
    reading = expose(world, np.ones((100, 160), np.uint8)) - 64.0
    views, _ = light.truth(world.exposures[0])
    scale = 50_000 * 0.02 / 2.7
    assert reading[0::2, 0::2] == pytest.approx(scale * views[0, 0::2, 0::2, 0], abs=1.0)
    assert reading[0::2, 1::2] == pytest.approx(scale * views[0, 0::2, 1::2, 1], abs=1.0)
    assert reading[1::2, 1::2] == pytest.approx(scale * views[0, 1::2, 1::2, 2], abs=1.0)


def test_behind_a_lens_the_truth_is_what_the_sensor_sees():
    light, world = make(effects=(LensDistortion(-0.2),))
    reading = expose(world, np.ones((100, 160), np.uint8))
    views, _ = light.truth(world.exposures[0])
    expected = 64.0 + views[0, ..., 0] * 50_000 * 0.02 / 2.7
    assert reading == pytest.approx(expected, abs=1.0)
    straight, plain_world = make()
    expose(plain_world, np.ones((100, 160), np.uint8))
    assert np.abs(views - straight.truth(plain_world.exposures[0])[0]).max() > 0.1
    assert light.lens == LensDistortion(-0.2)
    assert straight.lens is None


@pytest.mark.parametrize("lens", [(), (LensDistortion(-0.2),)], ids=["straight", "distorted"])
@pytest.mark.parametrize("kind", ["object", "camera"])
def test_the_truth_is_where_the_effects_moved_object_and_camera(kind, lens):
    """Each mask opens one band of rows for a moment, so a band reads the light of that mask's middle."""
    scene = planes(np.random.default_rng(1), SIZE)
    near = scene.depth_range()[0]
    width = near * SIZE[1] / scene.intrinsics[0, 0]
    moved = ObjectMotion((0.0, 0.0, near), 0.5 * width, (2 * width, 0.0, 0.0))
    effect = moved if kind == "object" else StageVibration(0.05 * width, 8.0)
    light, world = make(effects=(effect, *lens))
    bands = np.arange(100)[:, None] // 2 * np.ones(160, int) // 10 % 4
    start_s = world.clock.now_s()
    for mask in range(4):
        world.show_mask((bands == mask).astype(np.uint8))
        world.clock.sleep_s(0.008)
        world.show_mask(np.zeros((100, 160), np.uint8))
        world.clock.sleep_s(0.032)
    reading = world.integrate(start_s, world.clock.now_s(), height=SIZE[0], width=SIZE[1], bits=12)
    exposure = world.exposures[0]
    views, poses = light.truth(exposure)
    masks = light.true_masks(np.stack([shown.levels for shown in exposure.masks]))
    errors = {}
    for name, truth in (("told", views), ("at rest", make(effects=lens)[0].truth(exposure)[0])):
        expected = 64.0 + np.einsum("nhw,nhwc->hw", masks, truth) * 50_000 * 0.008 / 2.7
        errors[name] = np.sqrt(np.square(reading - expected).mean())
    assert errors["told"] < 0.2 * errors["at rest"]
    if kind == "camera":
        assert np.ptp(poses[:, :3, 3], axis=0).max() > 0.02 * width
    depth = light.true_depth(exposure)
    assert depth.shape == (8, *SIZE)
    assert not np.array_equal(depth[0], depth[6])


def test_noise_is_the_same_for_the_same_seed_and_new_in_each_exposure():
    def readings(seed):
        scene = planes(np.random.default_rng(1), SIZE)
        light = BenchLight(scene, SensorFigures(), MaskAlignment(2, 10, 20), full_scale_e_per_s=50_000.0, seed=seed)
        world = World(light)
        return [expose(world, np.ones((100, 160), np.uint8)) for _ in range(2)]

    first, again, other = readings(3), readings(3), readings(4)
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], other[0])


def test_a_sensor_that_looks_beyond_the_modulator_is_refused():
    with pytest.raises(InputError, match="looks beyond"):
        MaskAlignment(2, 90, 0).on_sensor(MaskInterval(np.ones((100, 160), np.uint8), 1, 0.0, 1.0), *SIZE)


def test_a_sensor_of_another_size_than_the_scene_is_refused():
    _, world = make()
    world.clock.sleep_s(1.0)
    with pytest.raises(InputError, match=r"same height and width.*binning out"):
        world.integrate(world.clock.now_s() - 0.1, world.clock.now_s(), height=8, width=8, bits=12)


def test_each_exposure_keeps_the_plan_of_what_was_simulated():
    light, world = make()
    expose(world, np.ones((100, 160), np.uint8))
    expose(world, np.ones((100, 160), np.uint8))
    assert sorted(light.plans) == [0, 1]
    assert light.plans[0] is light.plans[1]  # nothing moved: one plan for both
    assert light.plans[0].views == 1
    assert "tolerance" in light.plans[0].summary()


@pytest.mark.parametrize("before", ["grey", "the same share in another place"])
def test_a_mask_reads_the_same_whatever_mask_was_shown_before(before):
    """Both masks have a mean transmission of a half: a plan made for one must not serve the other."""
    grey = np.full((100, 160), 128, np.uint8)
    blocks = (np.indices((100, 160)).sum(axis=0) // 2 % 2 * 255).astype(np.uint8)
    halves = np.where(np.arange(160) < 80, 255, 0).repeat(100).reshape(160, 100).T.astype(np.uint8)
    shown_first = grey if before == "grey" else halves

    def readings(levels):
        light, world = make(effects=(MaskEdges(0.5),))
        found = []
        for pattern in levels:
            start_s = world.clock.now_s()
            world.show_mask(pattern, top=255)
            world.clock.sleep_s(0.02)
            found.append(world.integrate(start_s, start_s + 0.02, height=SIZE[0], width=SIZE[1], bits=12))
        return found[-1].astype(int), light.plans[len(levels) - 1]

    alone, plan_alone = readings([blocks])
    after, plan_after = readings([shown_first, blocks])
    assert np.abs(alone - after).max() <= 1
    assert plan_after.record() == plan_alone.record()


def test_a_plan_is_shared_by_exposures_of_the_same_masks_alone():
    light, world = make()
    expose(world, np.ones((100, 160), np.uint8))
    expose(world, np.eye(100, 160, dtype=np.uint8))
    expose(world, np.ones((100, 160), np.uint8))
    assert light.plans[0] is light.plans[2]
    assert light.plans[0] is not light.plans[1]


def test_a_plan_knows_the_lamps_level():
    """The lamp brightens until pixels are full; a plan of the first minute would leave the full well out."""
    light, world = make(lamp_drift_per_min=0.1, full_scale_e_per_s=500_000.0)
    first = expose(world, np.ones((100, 160), np.uint8))
    for _ in range(2):
        expose(world, np.ones((100, 160), np.uint8))
    assert light.plans[1] is light.plans[2]  # the lamp has hardly changed: one plan for both
    world.clock.sleep_s(600.0)
    late = expose(world, np.ones((100, 160), np.uint8)).astype(float)
    full_dn = 64.0 + SensorFigures().full_well_e / 2.7
    wanted = np.minimum(64.0 + 2 * (first - 64.0), full_dn)
    assert first.max() < full_dn < 2 * first.max()
    assert "full_well" not in {effect.name for effect in light.plans[0].effects}
    assert "full_well" in {effect.name for effect in light.plans[3].effects}
    np.testing.assert_allclose(late, wanted, atol=5.0)


def test_a_lamp_that_has_died_gives_no_light():
    _, world = make(lamp_drift_per_min=-0.1)
    world.clock.sleep_s(1200.0)
    assert (expose(world, np.ones((100, 160), np.uint8)) == 64).all()


def test_a_camera_that_trembles_is_planned_anew_each_time():
    light, world = make(effects=(StageVibration(1e-3, 50.0),))
    expose(world, np.ones((100, 160), np.uint8))
    expose(world, np.ones((100, 160), np.uint8))
    assert light.plans[0] is not light.plans[1]
