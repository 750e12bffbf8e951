import dataclasses

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.path import StageMove, stage_move_for_parallax

TIMES = np.linspace(-0.4, 0.4, 9)


def centres(poses):
    return np.linalg.inv(poses)[:, :3, 3]


def test_the_camera_moves_at_constant_velocity_through_the_reference_pose():
    reference = np.eye(4)
    reference[:3, 3] = (1.0, 2.0, 3.0)
    poses = StageMove((0.3, -0.1, 0.05), 0.2, 1.5, reference).world_to_camera(TIMES)
    moved = centres(poses) - centres(reference[None])
    np.testing.assert_allclose(moved, TIMES[:, None] * [0.3, -0.1, 0.05], atol=1e-12)


def test_the_velocity_is_along_the_reference_cameras_own_axes():
    quarter_turn = np.array([[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
    poses = StageMove((1.0, 0, 0), reference_world_to_camera=quarter_turn).world_to_camera(np.array([0.5]))
    np.testing.assert_allclose(centres(poses)[0], 0.5 * quarter_turn[0, :3], atol=1e-12)


def test_poses_are_rigid_and_turn_by_no_more_than_the_wobble():
    rotations = StageMove((0.1, 0, 0), 0.2, 3.0).world_to_camera(TIMES)[:, :3, :3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (9, 1, 1)), atol=1e-12)
    angles = np.rad2deg(np.arccos((np.trace(rotations, axis1=1, axis2=2) - 1) / 2))
    # Three axes a third of a turn apart: sin² adds up to 3/2 at any time.
    np.testing.assert_allclose(angles, 0.2 * 1.5**0.5, rtol=1e-3)


def test_without_wobble_nothing_turns():
    assert np.array_equal(StageMove((1.0, 0, 0)).world_to_camera(TIMES)[:, :3, :3], np.tile(np.eye(3), (9, 1, 1)))


def test_near_and_far_shift_against_each_other_by_the_parallax_asked_for(small_scene):
    path = stage_move_for_parallax(small_scene, 6.0, 0.8, wobble_deg=0.0, direction=(1.0, 0.0, 0.0))
    poses = path.world_to_camera(np.array([-0.4, 0.4]))
    points = np.array([[0, 0, z, 1.0] for z in small_scene.depth_range()])
    seen = np.einsum("vij,nj->vni", poses, points)
    x = small_scene.intrinsics[0, 0] * seen[..., 0] / seen[..., 2]
    shift = x[1] - x[0]
    assert abs(shift[0] - shift[1]) == pytest.approx(6.0, rel=1e-9)


@pytest.mark.parametrize("changes", [{"velocity": (np.nan, 0, 0)}, {"wobble_hz": -1.0}, {"wobble_deg": np.inf}])
def test_a_move_that_is_not_finite_is_refused(changes):
    with pytest.raises(InputError, match=r"velocity = .* in StageMove|wobble_hz = -1|wobble_deg = inf"):
        StageMove(**{"velocity": (0.1, 0, 0), **changes})


@pytest.mark.parametrize(
    ("parallax_px", "duration_s", "direction"), [(-1, 1, (1, 0, 0)), (5, 0, (1, 0, 0)), (5, 1, (0, 0, 1))]
)
def test_a_parallax_that_no_move_gives_is_refused(small_scene, parallax_px, duration_s, direction):
    with pytest.raises(InputError, match="parallax"):
        stage_move_for_parallax(small_scene, parallax_px, duration_s, direction=direction)


def test_a_scene_at_one_depth_gets_a_sentence_instead_of_an_endless_move(small_scene):
    flat = dataclasses.replace(small_scene, depth=np.full(small_scene.size, 3.0))
    with pytest.raises(InputError, match="lies at one depth"):
        stage_move_for_parallax(flat, 5.0, 1.0)
