"""Similarities: what they do to points and poses, and small changes of them."""

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity


def drawn(seed):
    rng = np.random.default_rng(seed)
    return Similarity(float(rng.uniform(0.3, 3)), Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


def test_the_inverse_undoes_a_similarity_and_one_after_another_is_both():
    one, other, points = drawn(0), drawn(1), np.random.default_rng(2).normal(size=(5, 3))
    np.testing.assert_allclose(one.inverse.points(one.points(points)), points, atol=1e-12)
    np.testing.assert_allclose(one.after(other).points(points), one.points(other.points(points)), atol=1e-12)
    np.testing.assert_array_equal(Similarity.identity().points(points), points)


def test_poses_see_moved_points_where_they_saw_them():
    one, points = drawn(3), np.random.default_rng(4).normal(size=(5, 3))
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3], poses[1, :3, 3] = Rotation.random(random_state=5).as_matrix(), (0.3, -1.0, 2.0)
    moved = one.poses(poses)
    before = points @ poses[1, :3, :3].T + poses[1, :3, 3]
    after = one.points(points) @ moved[1, :3, :3].T + moved[1, :3, 3]
    np.testing.assert_allclose(after, one.scale * before, atol=1e-12)
    np.testing.assert_allclose(camera_centres(moved), one.points(camera_centres(poses)), atol=1e-12)


def test_a_change_leads_from_one_similarity_to_another():
    one, other, centre = drawn(6), drawn(7), np.array([0.2, -0.4, 1.5])
    change = one.change_to(other, centre, 2.5)
    assert change.shape == (CHANGES,)
    there = one.changed(change, centre, 2.5)
    points = np.random.default_rng(8).normal(size=(5, 3))
    np.testing.assert_allclose(there.points(points), other.points(points), atol=1e-9)


def test_turns_and_scales_leave_the_centre_where_it_is():
    one, centre = drawn(9), np.array([0.2, -0.4, 1.5])
    turned = one.changed(np.array([0.1, 0.2, -0.1, 0, 0, 0, 0.3]), centre, 1.0)
    np.testing.assert_allclose(turned.points(centre), one.points(centre), atol=1e-12)
    moved = one.changed(np.array([0, 0, 0, 1.0, 0, 0, 0]), centre, 2.0)
    np.testing.assert_allclose(moved.points(centre) - one.points(centre), (2, 0, 0), atol=1e-12)
