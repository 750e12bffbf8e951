import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.bench_light import BenchLight
from gs2ci_sims.effects.noises import Prnu
from gs2ci_sims.effects.views import Defocus
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.targets import BoardPlane, EvenLight, board_scene
from gs2ci_sims.world import World

SIZE = (40, 60)


@pytest.fixture
def light():
    scene = planes(np.random.default_rng(1), SIZE)
    effects = (Prnu(0.02), Defocus(1.0, 2.0))
    return BenchLight(
        scene, SensorFigures(), MaskAlignment(1, 0, 0), full_scale_e_per_s=50_000.0, noise=False, effects=effects
    )


def expose(light, seconds=0.02):
    world = World(light)
    start_s = world.clock.now_s()
    world.show_mask(np.ones(SIZE, np.uint8))
    world.clock.sleep_s(seconds)
    return world.integrate(start_s, start_s + seconds, height=SIZE[0], width=SIZE[1], bits=12).astype(float)


def test_an_even_light_fills_every_pixel_alike_but_for_the_sensors_own_response(light):
    light.look_at_even_light(0.5)
    reading = expose(light) - 64
    factors = light.fixed_pattern(Prnu(0.02), np.ones((*SIZE, 1)), light.nominal_rig(12))[..., 0]
    assert reading == pytest.approx(0.5 * 50_000 * 0.02 / 2.7 * factors, abs=0.6)


def test_with_the_lens_cap_on_there_is_only_black(light):
    light.look_at_nothing()
    assert (expose(light) == 64).all()
    light.look_at_scene()
    assert (expose(light) > 64).any()


def test_a_lamp_that_drifts_dims_over_the_worlds_time(light):
    fading = BenchLight(
        light.scene,
        SensorFigures(),
        MaskAlignment(1, 0, 0),
        full_scale_e_per_s=50_000.0,
        noise=False,
        lamp_drift_per_min=-0.6,
    )
    fading.look_at_even_light(1.0)
    world = World(fading)
    means = []
    for _ in range(2):
        start_s = world.clock.now_s()
        world.show_mask(np.ones(SIZE, np.uint8))
        world.clock.sleep_s(0.02)
        means.append(world.integrate(start_s, start_s + 0.02, height=40, width=60, bits=12).mean() - 64)
        world.clock.sleep_s(9.98)
    assert means[1] / means[0] == pytest.approx(0.9, abs=0.005)


def test_a_board_fills_most_of_the_view_and_has_another_pose_for_each_index():
    scene = planes(np.random.default_rng(1), SIZE)
    plane = BoardPlane(7, 5, 1.0, 0.7)
    poses = [plane.pose(index, scene, seed=3) for index in (0, 1, 1)]
    assert not np.allclose(poses[0], poses[1])
    assert np.array_equal(poses[1], poses[2])
    for pose in poses:
        corners = np.array([[x, y, 0.0, 1.0] for x in (0, 7) for y in (0, 5)]) @ pose.T
        px = corners[:, :3] @ scene.intrinsics.T
        span = np.ptp(px[:, :2] / px[:, 2:], axis=0) / np.array([SIZE[1], SIZE[0]])
        assert 0.4 < span.max() < 1.3
    seen, board = board_scene(scene, plane, 0, 3)
    view = board.views(seen, scene.world_to_camera[None])[0][0]
    assert view.min() < 0.3
    assert view.max() > 0.6


def test_impossible_targets_are_refused():
    with pytest.raises(InputError, match="radiance = -1"):
        EvenLight(radiance=-1.0)
    for wrong in ((2, 5, 1.0, 0.7), (7, 5, 1.0, 1.0)):
        with pytest.raises(InputError, match=r"a dictionary of cv2\.aruco"):
            BoardPlane(*wrong)
    with pytest.raises(InputError, match="DICT_NONE"):
        BoardPlane(7, 5, 1.0, 0.7, "DICT_NONE")
