import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.path.rotations import fit_rotations


def turning(views, amount=0.03):
    poses = np.tile(np.eye(4), (views, 1, 1))
    along = np.arange(views) - views // 2
    poses[:, :3, :3] = Rotation.from_rotvec(amount * along[:, None] * (0.3, 1.0, 0.2) / views).as_matrix()
    return poses


def test_pure_rotations_are_found_exactly(tracked, compare):
    poses = turning(6)
    scene = tracked(views=6, poses=poses)
    fitted = fit_rotations(scene.tracks, scene.intrinsics)
    assert fitted.rms_px < 1e-6
    np.testing.assert_allclose(fitted.rotations, poses[:, :3, :3], atol=1e-9)
    assert fitted.displacement_px == pytest.approx(0.03 * 3 / 6 * 1.05 * 300, rel=0.15)


def test_outliers_hardly_turn_them(tracked, compare):
    poses = turning(6)
    scene = tracked(views=6, poses=poses, noise_px=0.3, outliers=0.5)
    fitted = fit_rotations(scene.tracks, scene.intrinsics)
    estimate = np.tile(np.eye(4), (6, 1, 1))
    estimate[:, :3, :3] = fitted.rotations
    assert compare[1](estimate, poses) < 0.1


def test_a_view_without_tracks_stays_where_it_is(tracked):
    scene = tracked(views=4)
    scene.tracks.positions[:, 3] = np.nan
    fitted = fit_rotations(scene.tracks, scene.intrinsics)
    np.testing.assert_allclose(fitted.rotations[3], np.eye(3), atol=1e-12)
    assert np.isfinite(fitted.rms_px)
