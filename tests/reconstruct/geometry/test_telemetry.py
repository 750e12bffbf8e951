import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import GeometryError
from gs2ci.reconstruct.geometry.motion import predict_positions
from gs2ci.reconstruct.geometry.telemetry import place_points
from gs2ci.reconstruct.geometry.tracks import Tracks

INTRINSICS = np.array([[300.0, 0, 160], [0, 310.0, 120], [0, 0, 1]])
REFERENCE = 3


def stage_poses(views=7, step_mm=4.0, turn_deg=0.3):
    """A stage move along x in millimetres, seen in some frame of the bench, with a slight turn."""
    poses = np.tile(np.eye(4), (views, 1, 1))
    for i in range(views):
        poses[i, :3, :3] = Rotation.from_euler("y", turn_deg * i, degrees=True).as_matrix()
        poses[i, :3, 3] = (step_mm * i, 0.1 * i, 20.0)
    return poses


def tracks_of(poses, depth_mm, noise_px, rng):
    relative = poses @ np.linalg.inv(poses[REFERENCE])
    at = rng.uniform((5, 5), (315, 235), (len(depth_mm), 2))
    positions = predict_positions(at, 1 / depth_mm, relative, INTRINSICS)
    positions += noise_px * rng.standard_normal(positions.shape)
    return Tracks(positions, REFERENCE)


def test_depths_follow_from_known_poses_at_the_scale_of_median_one():
    rng = np.random.default_rng(0)
    depth_mm = rng.uniform(400, 1500, 300)
    tracks = tracks_of(stage_poses(), depth_mm, 0.0, rng)
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert len(kept) == 300
    expected = np.median(1 / depth_mm)
    np.testing.assert_allclose(motion.inverse_depth * expected, 1 / depth_mm, rtol=1e-6)
    relative = stage_poses() @ np.linalg.inv(stage_poses()[REFERENCE])
    np.testing.assert_allclose(motion.translations, relative[:, :3, 3] * expected, rtol=1e-6, atol=1e-12)
    assert motion.rms_px < 1e-9


def test_noise_and_outliers_leave_the_depths_within_their_error():
    rng = np.random.default_rng(1)
    depth_mm = rng.uniform(400, 900, 200)
    tracks = tracks_of(stage_poses(), depth_mm, 0.3, rng)
    tracks.positions[:20, 5] += 25.0
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert 150 < len(kept) <= 180
    depth = 1 / (motion.inverse_depth * np.median(1 / depth_mm))
    honest = np.isin(tracks.positions[:, 0, 0], kept.positions[:, 0, 0])
    # 12 mm to either side at 650 mm move a point by 5.5 px; 0.3 px in the reference view alone are 5 % of that.
    assert np.median(np.abs(depth / depth_mm[honest] - 1)) < 0.03


def test_points_that_few_views_see_are_placed_by_those():
    rng = np.random.default_rng(2)
    depth_mm = rng.uniform(400, 900, 50)
    tracks = tracks_of(stage_poses(), depth_mm, 0.0, rng)
    tracks.positions[:25, :2] = np.nan
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert len(kept) == 50
    np.testing.assert_allclose(motion.inverse_depth * np.median(1 / depth_mm), 1 / depth_mm, rtol=1e-6)


@pytest.mark.parametrize("change", ["still", "reversed"])
def test_poses_that_contradict_the_tracks_are_refused(change):
    rng = np.random.default_rng(3)
    poses = stage_poses(turn_deg=0.0)
    tracks = tracks_of(poses, rng.uniform(400, 900, 50), 0.1, rng)
    wrong = poses.copy()
    if change == "still":
        wrong[:] = wrong[0]
    else:
        wrong[:, 0, 3] *= -1
    with pytest.raises(GeometryError, match="infinity or behind"):
        place_points(tracks, wrong, INTRINSICS, 1.0, 3.0)
