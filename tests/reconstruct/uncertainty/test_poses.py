import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import camera_centres
from gs2ci.evaluate.trajectory import align
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.poses import errors_of_poses, unseen_turn
from tests.reconstruct.uncertainty.conftest import path
from tests.render import se3

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
    positions, rotations = errors_of_poses(np.diag(spread**2), true, 2.0, (0.0, 0.0), given=True)
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
    positions, rotations = errors_of_poses(np.outer(step, step), poses, 2.0, (0.0, 0.0), given=True)
    assert np.allclose(positions, 0, atol=1e-9)
    assert np.allclose(rotations, 0, atol=1e-9)


def test_a_path_that_was_found_errs_by_more_than_gauss_newton_says_and_turns_with_its_travel():
    poses, covariance = bent(), 1e-8 * np.eye(42)
    given, found = (errors_of_poses(covariance, poses, 2.0, (turn, 0.0), given=not turn) for turn in (0.0, 1e-3))
    assert found[0] == pytest.approx(np.maximum(factors.position * given[0], factors.out_of_step * 2e-3))
    assert found[1][0] > found[1][3]
    assert np.square(found[1]).mean() == pytest.approx(np.square(factors.turn * given[1]).mean() + 1e-6)


def test_positions_err_by_what_fits_differ_by_or_by_the_turn_that_no_reading_shows_where_that_is_more():
    poses, covariance = bent(), np.diag(np.linspace(1, 2, 42) * 1e-8)
    one, alike, several, turned = (
        errors_of_poses(covariance, poses, 2.0, (turn, 0.0), spread=spread, given=False)
        for turn, spread in ((1e-3, 0.0), (1e-3, 1e-6), (1e-3, 0.05), (0.25, 0.05))
    )
    assert np.array_equal(alike, one)
    assert np.square(several[0]).mean() == pytest.approx(0.05**2)
    assert np.argmax(several[0]) == np.argmax(one[0])
    assert np.array_equal(several[1], one[1])
    least = factors.out_of_step * 2.0 * 0.25
    assert np.array_equal(turned[0], several[0].clip(min=least))
    assert several[0].min() < least < several[0].max()


def test_given_poses_turn_with_the_travel_as_far_as_the_stage_states():
    poses, covariance = bent(), 1e-8 * np.eye(42)
    sure, unsure = (errors_of_poses(covariance, poses, 2.0, (1e-3, turn), given=True) for turn in (0.0, 1e-2))
    assert np.array_equal(sure[0], unsure[0])
    assert np.square(unsure[1]).mean() == pytest.approx(np.square(sure[1]).mean() + 1e-4)


@pytest.mark.parametrize("poses", [path(1), path(2), path(5, (0, 0, 0))], ids=["one view", "two views", "at rest"])
def test_paths_that_determine_no_alignment_have_finite_errors(poses):
    positions, rotations = errors_of_poses(1e-6 * np.eye(6 * len(poses)), poses, 1.0, (1e-3, 0.0), given=False)
    for errors in (positions, rotations):
        assert errors.shape == (len(poses),)
        assert np.isfinite(errors).all()


def seen_at(focal_px, size=(72, 96)):
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    return np.stack([columns - size[1] / 2, rows - size[0] / 2], axis=-1) / focal_px


def test_readings_do_not_see_a_turn_that_displaces_a_picture_hardly_otherwise_than_a_shift():
    """What a turn does to a picture beyond a shift falls with the square of the field of view, by moving its pixels."""
    turn, rays = unseen_turn(seen_at(100.0), FOCAL_PX), seen_at(100.0)
    left = []
    for axis in ([0.0, turn, 0.0], [turn, 0.0, 0.0]):
        there = Rotation.from_rotvec(axis).apply(
            np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1).reshape(-1, 3)
        )
        flow = 100 * (there[:, :2] / there[:, 2:] - rays.reshape(-1, 2))
        left.append(flow.var(axis=0).sum())
    assert np.sqrt(np.mean(left) * 72 * 96) == pytest.approx(factors.unseen_px, rel=0.02)
    # In px, four times the turn at twice the focal length; half of it with four times the pixels in the same field.
    assert unseen_turn(seen_at(200.0), 2 * FOCAL_PX) == pytest.approx(2 * turn)
    assert unseen_turn(seen_at(200.0, (144, 192)), 2 * FOCAL_PX) == pytest.approx(turn / 4, rel=1e-3)


def test_no_turn_is_larger_than_what_is_known_beforehand_or_given():
    assert unseen_turn(seen_at(1e4), 100 * FOCAL_PX) == factors.turn_prior
    assert unseen_turn(seen_at(100.0), FOCAL_PX, 1e-4) == 1e-4
    assert unseen_turn(np.zeros((1, 1, 2)), FOCAL_PX, 0.0) == 0
