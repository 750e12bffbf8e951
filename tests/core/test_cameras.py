"""The matrix of an ideal camera, and where cameras stand."""

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import camera_centres, in_world, pinhole


def test_a_pinhole_has_its_principal_point_in_the_middle():
    np.testing.assert_array_equal(pinhole(300, (240, 320)), [[300, 0, 160], [0, 300, 120], [0, 0, 1]])


def test_cameras_stand_where_their_poses_send_the_origin():
    rng = np.random.default_rng(0)
    centres = rng.normal(size=(3, 3))
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = Rotation.random(3, rng).as_matrix()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    np.testing.assert_allclose(camera_centres(poses), centres, atol=1e-12)


def test_points_in_the_world_are_seen_where_they_came_from():
    rng = np.random.default_rng(1)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    in_camera = rng.normal(size=(5, 3))
    found = in_world(in_camera, pose)
    np.testing.assert_allclose(found @ pose[:3, :3].T + pose[:3, 3], in_camera, atol=1e-12)
