import numpy as np
import pytest

from gs2ci.core.cameras import camera_centres
from gs2ci.evaluate.trajectory import align
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.poses import errors_of_poses, relief, travel_across
from gs2ci.render import se3
from tests.reconstruct.uncertainty.conftest import path

FOCAL_PX = np.array([100.0, 100.0])


def bent(count=7):
    """A path that bends, so that positions determine its alignment."""
    poses = path(count)
    poses[:, 1, 3] = 0.05 * np.linspace(-1, 1, count) ** 2
    poses[:, 2, 3] = 0.03 * np.sin(np.linspace(0, 5, count))
    return poses


def test_stated_positions_and_turns_are_those_of_drawn_errors():
    import torch  # noqa: PLC0415  only here

    true, rng = bent(), np.random.default_rng(0)
    spread = np.tile([2e-4] * 3 + [1e-4] * 3, len(true))
    positions, rotations = errors_of_poses(np.diag(spread**2), true, 2.0, FOCAL_PX, given=True)
    far, turned = [], []
    for _ in range(300):
        twists = torch.from_numpy((spread * rng.standard_normal(len(spread))).reshape(-1, 6))
        found = se3.exp(twists).numpy() @ true
        aligned = align(found, true).apply(found)
        far.append(np.square(camera_centres(aligned) - camera_centres(true)).sum(axis=1))
        turned.append(np.square(twists[:, 3:].numpy() - twists[:, 3:].numpy().mean(axis=0)).sum(axis=1))
    assert positions == pytest.approx(np.sqrt(np.mean(far, axis=0)), rel=0.15)
    assert rotations == pytest.approx(np.sqrt(np.mean(turned, axis=0)), rel=0.1)


def test_a_common_motion_of_all_cameras_is_no_error():
    poses = bent()
    # All cameras move by the same step of the world: the covariance of one direction.
    step = np.concatenate([np.concatenate([-pose[:3, :3] @ [1.0, 2, 3], np.zeros(3)]) for pose in poses])
    positions, rotations = errors_of_poses(np.outer(step, step), poses, 2.0, FOCAL_PX, given=True)
    assert np.allclose(positions, 0, atol=1e-9)
    assert np.allclose(rotations, 0, atol=1e-9)


def test_a_path_that_was_found_errs_by_more_than_gauss_newton_says_and_turns_with_its_travel():
    poses, covariance = bent(), 1e-8 * np.eye(42)
    given, found = (errors_of_poses(covariance, poses, 2.0, FOCAL_PX, given=given) for given in (True, False))
    assert found[0] == pytest.approx(factors.position * given[0])
    assert found[1][0] > found[1][3]
    assert (found[1] >= factors.turn * given[1]).all()


@pytest.mark.parametrize("poses", [path(1), path(2), path(5, (0, 0, 0))], ids=["one view", "two views", "at rest"])
def test_paths_that_determine_no_alignment_have_finite_errors(poses):
    positions, rotations = errors_of_poses(1e-6 * np.eye(6 * len(poses)), poses, 1.0, FOCAL_PX, given=False)
    for errors in (positions, rotations):
        assert errors.shape == (len(poses),)
        assert np.isfinite(errors).all()


def test_travel_across_counts_by_the_angle_at_the_middle_depth_and_travel_ahead_does_not():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = -np.array([-0.3, 0.0, 0.3])
    poses[:, 2, 3] = -np.array([0.0, 5.0, 1.0])
    assert travel_across(poses, 6.0) == pytest.approx([0.05, 0, 0.05])


def test_the_shorter_the_travel_in_the_picture_the_less_sure_is_the_shift_of_all_inverse_depths():
    """A turn that moves the picture by RELIEF_PX takes the place of so much of 5 px, half as much of 10 px."""
    across = np.array([0.05, 0, 0.05])
    assert relief(across, FOCAL_PX) == pytest.approx(factors.relief_px / 5)
    assert relief(across, 2 * FOCAL_PX) == pytest.approx(factors.relief_px / 10)
    assert relief(0 * across, FOCAL_PX) == 1
