import numpy as np
import pytest

from gs2ci.core.lens import distorted, pixels_of, slopes_of, undistorted
from gs2ci.reconstruct.paper.priors2d.consistent import ConsistentDetail


def spot_seen_from(shifts, column, size=(20, 32)):
    """A bright spot of the plane, at `column` of the camera with shift 0, as each camera sees it."""
    details = np.zeros((len(shifts), *size, 3), np.float32)
    for detail, shift in zip(details, shifts, strict=True):
        detail[10, column - shift] = 0.3
    return details


def test_what_all_cameras_see_is_put_where_the_pseudo_view_sees_it(plane):
    question = plane(spot_seen_from((0, 1, 2, 3), 15))
    added = ConsistentDetail()(question) - np.clip(question.pseudo.images, 0, 1)
    assert added[0, 10, 14] == pytest.approx(np.minimum(0.3, 1 - question.pseudo.images[0, 10, 14]), abs=1e-4)
    added[0, 10, 14] = 0
    assert np.abs(added).max() < 1e-4


def test_behind_a_lens_rays_are_bent_there_and_back(plane):
    """A spot that moves from the rim of the pseudo-view, camera 1, to the middle of the others, where nothing bends."""
    lens, focal, shifts = np.array([-0.3, 0, 0, 0, 0]), 30.0, (1, 9, 11, 13)
    camera = np.array([[focal, 0, 16], [0, focal, 10], [0, 0, 1]])
    ray = undistorted(slopes_of(np.array([28.5, 3.5]), camera), lens)
    rows, columns = np.mgrid[:20, :32]
    spots = []
    for shift in shifts:
        x, y = pixels_of(distorted(ray - ((shift - 1) / focal, 0), lens), camera) - 0.5
        spots.append(np.maximum(1 - np.abs(columns - x), 0) * np.maximum(1 - np.abs(rows - y), 0))
    details = np.repeat(np.stack(spots)[..., None], 3, axis=3).astype(np.float32)
    added = {}
    for name, distortion in (("lens", lens), ("pinhole", None)):
        question = plane(0.2 * details, distortion=distortion)
        question.pseudo.images[:] = 0.2
        question.recovered.world_to_camera[:, 0, 3] = -np.array(shifts) / focal
        added[name] = (ConsistentDetail()(question) - question.pseudo.images)[0, 3, 28, 0]
    # Interpolated twice, the spot has lost some of its height.
    assert added["lens"] > 0.08
    assert added["lens"] > 2 * added["pinhole"]


def test_what_one_camera_alone_sees_is_dropped(plane):
    details = np.zeros((4, 20, 32, 3), np.float32)
    details[2] = np.random.default_rng(1).normal(0, 0.3, details[2].shape)
    question = plane(details)
    np.testing.assert_array_equal(ConsistentDetail()(question), np.clip(question.pseudo.images, 0, 1))


def test_a_camera_that_sees_something_nearer_has_no_say(plane):
    question = plane(spot_seen_from((0, 1, 2, 3), 15))
    question.recovered.depths[1:] = 0.5
    np.testing.assert_array_equal(ConsistentDetail()(question), np.clip(question.pseudo.images, 0, 1))


def test_where_nothing_stops_the_light_nothing_is_added(plane):
    question = plane(np.full((4, 20, 32, 3), 0.2, np.float32), depth=0.0)
    np.testing.assert_array_equal(ConsistentDetail()(question), np.clip(question.pseudo.images, 0, 1))


def test_points_behind_a_camera_are_not_seen_by_it(plane):
    question = plane(np.full((4, 20, 32, 3), 0.2, np.float32))
    turned = question.recovered.world_to_camera
    turned[:, :3, :3] = np.diag([-1.0, 1.0, -1.0])
    np.testing.assert_array_equal(ConsistentDetail()(question), np.clip(question.pseudo.images, 0, 1))


def test_the_nearest_cameras_are_asked(plane):
    """Two cameras agree on nothing, the far ones on a spot: with two neighbours it is not added."""
    details = spot_seen_from((0, 1, 6, 7), 20)
    details[:2] = 0
    question = plane(details, shifts=(0, 1, -3, -4), pseudo=0)
    assert np.array_equal(ConsistentDetail(neighbours=2)(question), np.clip(question.pseudo.images, 0, 1))
