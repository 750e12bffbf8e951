import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.paper.pseudo_views import (
    SupportSettings,
    beyond,
    interpolated,
    support_weights,
    synthesised_poses,
)


def pose(rotvec, translation=(0, 0, 0)):
    made = np.eye(4)
    made[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    made[:3, 3] = translation
    return made


def path(count):
    """A path that turns and moves by the same step each time."""
    step = pose((0.02, -0.05, 0.01), (0.1, -0.02, 0.03))
    poses = [np.eye(4)]
    while len(poses) < count:
        poses.append(step @ poses[-1])
    return np.stack(poses)


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-4, 1.0, 90.0, 179.0, 179.9999, 180.0])
@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 2, -0.5), (-1, 0, 0)])
def test_rotations_are_interpolated_along_the_shortest_arc_at_every_angle(degrees, axis):
    """Against the arc itself: α of the way is a turn by α of the angle about the same axis."""
    direction = np.array(axis) / np.linalg.norm(axis)
    start = Rotation.from_rotvec((0.3, -0.2, 0.5))
    a = pose(start.as_rotvec())
    b = pose((Rotation.from_rotvec(np.radians(degrees) * direction) * start).as_rotvec())
    for share in (0.25, 0.5, 0.75):
        found = interpolated(a, b, share)[:3, :3]
        ways = [Rotation.from_rotvec(sign * share * np.radians(degrees) * direction) * start for sign in (1, -1)]
        errors = [np.abs(found - way.as_matrix()).max() for way in (ways if degrees == 180 else ways[:1])]
        # An angle near 180° comes from a cosine whose derivative vanishes there: half the digits of float64 remain.
        assert min(errors) < (1e-7 if degrees > 179.9 else 1e-12)
        np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-13)


def test_translations_are_interpolated_linearly_and_the_ends_are_met():
    a, b = pose((0.1, 0, 0), (1, 2, 3)), pose((0, 0.4, 0), (3, 0, -1))
    np.testing.assert_allclose(interpolated(a, b, 0.25)[:3, 3], [1.5, 1.5, 2], atol=1e-15)
    np.testing.assert_allclose(interpolated(a, b, 0.0), a, atol=1e-15)
    np.testing.assert_allclose(interpolated(a, b, 1.0), b, atol=1e-15)


def test_a_path_is_continued_by_its_last_step():
    a, b, c = path(3)
    np.testing.assert_allclose(beyond(a, b), c, atol=1e-12)
    np.testing.assert_allclose(beyond(c, b), a, atol=1e-12)


def test_there_are_poses_between_all_neighbours_and_one_beyond_either_end():
    poses = path(6)
    made = synthesised_poses(poses[1:5], between=2)
    assert made.shape == (3 * 2 + 2, 4, 4)
    np.testing.assert_allclose(made[-2:], poses[[0, 5]], atol=1e-12)
    thirds = [interpolated(*poses[[1, 2]], share) for share in (1 / 3, 2 / 3)]
    np.testing.assert_allclose(made[:2], thirds, atol=1e-12)


def test_two_cameras_without_any_between_give_the_two_ends():
    assert synthesised_poses(path(2), between=0).shape == (2, 4, 4)


def test_one_camera_has_no_path():
    assert synthesised_poses(path(1)).shape == (0, 4, 4)


def test_a_camera_at_rest_is_left_at_rest():
    made = synthesised_poses(np.tile(path(2)[1], (3, 1, 1)))
    np.testing.assert_allclose(made, np.tile(path(2)[1], (4, 1, 1)), atol=1e-12)


def test_fewer_than_none_are_refused():
    with pytest.raises(InputError, match="-1 poses"):
        synthesised_poses(path(3), between=-1)


def test_pixels_count_by_the_smaller_alpha():
    then, now = torch.tensor([[1.0, 0.0, 1.0, 0.25]]), torch.tensor([[1.0, 1.0, 0.0, 0.5]], requires_grad=True)
    weights = support_weights(then, now, SupportSettings())
    nothing = 0.1 + 0.9 / (1 + np.exp(0.25 / 0.08))
    np.testing.assert_allclose(weights, [[1, nothing, nothing, 0.55]], atol=1e-4)
    assert not weights.requires_grad


def test_weights_rise_from_the_least_to_one():
    alphas = torch.linspace(0, 1, 50, dtype=torch.float64)
    weights = support_weights(alphas, torch.ones(50), SupportSettings(softness=0.02))
    assert (weights[1:] > weights[:-1] - 1e-12).all()
    assert float(weights[0]) == pytest.approx(0.1, abs=1e-5)
    assert float(weights[-1]) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("part", [{"threshold": 1.5}, {"softness": 0.0}, {"least": -0.1}, {"softness": float("inf")}])
def test_settings_out_of_range_are_refused(part):
    with pytest.raises(InputError, match=f"{next(iter(part))} = .* in SupportSettings"):
        SupportSettings(**part).check()
