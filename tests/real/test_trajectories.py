"""Camera paths of six published scenes, true and as reconstructed (TUM files)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.evaluate.trajectory import trajectory_errors

SCENES = ("airplants", "cozy2room", "factory", "hotdog", "tanabata", "vender")


def read_tum(path):
    """World-to-camera poses from `t x y z qx qy qz qw` lines, camera-to-world."""
    rows = np.loadtxt(path)
    camera_to_world = np.tile(np.eye(4), (len(rows), 1, 1))
    camera_to_world[:, :3, :3] = Rotation.from_quat(rows[:, 4:8]).as_matrix()
    camera_to_world[:, :3, 3] = rows[:, 1:4]
    return np.linalg.inv(camera_to_world)


def read_scene(shared_data, scene):
    folder = shared_data / "trajectories" / scene
    return read_tum(folder / "ours.txt"), read_tum(folder / "groundtruth.txt")


def textbook_nate(estimate, truth):
    """Umeyama's alignment written out on the centres alone."""
    a, b = (np.linalg.inv(poses)[:, :3, 3] for poses in (estimate, truth))
    a0, b0 = a - a.mean(0), b - b.mean(0)
    u, s, vt = np.linalg.svd(b0.T @ a0)
    d = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = np.trace(np.diag(s) @ d) / np.sum(a0**2)
    error = scale * a0 @ (u @ d @ vt).T - b0
    return np.sqrt(np.mean(np.sum(error**2, 1))) / np.linalg.norm(np.ptp(b, axis=0))


@pytest.mark.parametrize("scene", SCENES)
def test_nate_is_the_textbooks(shared_data, scene):
    estimate, truth = read_scene(shared_data, scene)
    assert trajectory_errors(estimate, truth).nate == pytest.approx(textbook_nate(estimate, truth), rel=1e-6)


@pytest.mark.parametrize("scene", SCENES)
def test_rotation_errors_are_those_of_the_cameras_not_of_the_roll_about_a_straight_path(shared_data, scene):
    errors = trajectory_errors(*read_scene(shared_data, scene))
    assert errors.free == "roll"
    assert errors.rotation_deg < 2.5


@pytest.mark.parametrize("scene", ["cozy2room", "tanabata", "vender"])
def test_straight_stage_moves_agree_to_a_tenth_of_a_degree(shared_data, scene):
    errors = trajectory_errors(*read_scene(shared_data, scene))
    assert errors.nate < 3e-4
    assert errors.rotation_deg < 0.1


@pytest.mark.parametrize("scene", SCENES)
def test_a_path_against_itself_has_no_error(shared_data, scene):
    _, truth = read_scene(shared_data, scene)
    errors = trajectory_errors(truth, truth)
    assert errors.nate == pytest.approx(0, abs=1e-9)
    assert errors.rotation_deg == pytest.approx(0, abs=1e-5)
    assert errors.rpe_r_deg == pytest.approx(0, abs=1e-5)
