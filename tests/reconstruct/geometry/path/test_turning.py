"""A turn in step with the travel that given poses lack."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import pinhole
from gs2ci.reconstruct.geometry.path.motion import predict_positions
from gs2ci.reconstruct.geometry.path.turning import turning
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

SIZE, VIEWS, REFERENCE = (96, 128), 9, 4
CAMERA = pinhole(120.0, SIZE)


def path(turn_deg=(0, 0, 0)):
    """A path to the right and a little ahead, of a camera that turns in step with it."""
    along = np.linspace(-0.5, 0.5, VIEWS)
    centres = along[:, None] * [0.15, 0.0, 0.03]
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(along[:, None] * turn_deg, degrees=True).as_matrix()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses


def tracked(poses, noise_px=0.1, seed=0, points=200):
    rng = np.random.default_rng(seed)
    starts = rng.uniform((2, 2), (126, 94), (points, 2))
    inverse_depth = rng.uniform(0.4, 1.6, points)
    seen = predict_positions(starts, inverse_depth, poses, CAMERA)
    seen += noise_px * rng.standard_normal(seen.shape)
    lost = rng.random((points, VIEWS)) > 0.9
    lost[:, REFERENCE] = False
    seen[lost] = np.nan
    return Tracks(seen, REFERENCE)


def found(true, given, **how):
    return turning(tracked(true, **how), given, CAMERA, SIZE, 1.0)


@pytest.mark.parametrize("turn_deg", [(0, 3.4, 0), (0, 0, 2.0), (1.0, 0, 0)])
@pytest.mark.parametrize("invented", [False, True])
def test_a_turn_that_the_poses_lack_or_invent_is_found_and_taken_out(turn_deg, invented):
    turning, straight = path(turn_deg=turn_deg), path()
    true, given = (straight, turning) if invented else (turning, straight)
    error = found(true, given)
    wanted = np.radians(turn_deg) * (-1 if invented else 1)
    # About the line of travel, nothing but the roll tells.
    assert np.allclose(error.by, wanted, atol=4 * error.error)
    assert error.error < np.radians(0.6)
    assert np.abs(error.world_to_camera - true)[:, :3, :3].max() < 3 * error.error


def test_the_unit_and_the_frame_of_given_poses_do_not_matter():
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_euler("xyz", [20, -30, 10], degrees=True).as_matrix(), (1, 2, 3)
    given = path()
    given[:, :3, 3] *= 40
    one, other = found(path((0, 3, 0)), path()), found(path((0, 3, 0)), given @ frame)
    assert np.allclose(one.by, other.by, atol=1e-6)


def test_its_stated_error_is_that_of_repeated_tracks_times_what_neighbours_share():
    """The variance is three times that of independent errors, and counted twice: by residuals and by cells."""
    errors = [found(path((6, 6, 6)), path(), seed=seed) for seed in range(30)]
    assert all(error.by.all() for error in errors)
    least_sure = np.sqrt(np.linalg.eigvalsh(np.cov(np.transpose([error.by for error in errors])))[-1])
    assert 1.5 < np.mean([error.error for error in errors]) / least_sure < 4.5


def test_poses_that_lack_no_turn_stay_as_they_are():
    errors = [found(path(), path(), seed=seed) for seed in range(30)]
    assert not any(error.by.any() for error in errors)


def test_what_tracks_do_not_tell_of_a_turn_is_left():
    """The roll shows in any picture; a turn to the side hardly does beside other depths."""
    error = found(path((0, 0, 2.0)), path(), noise_px=0.5)
    assert np.degrees(error.by) == pytest.approx([0, 0, 2.0], abs=0.5)
    assert np.degrees(np.abs(error.by[:2])).max() < 0.2 < np.degrees(error.error)


def test_a_single_point_tells_nothing():
    error = found(path((0, 3, 0)), path(), points=1)
    assert not error.by.any()
    assert error.error <= 0.2 * 3**0.5 + 1e-6
