import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.evaluate.trajectory import align, rotation_angles_deg, trajectory_errors


def poses(centers, rotations=None):
    """World-to-camera poses from centres [N, 3] and camera-to-world rotations."""
    centers = np.asarray(centers, np.float64)
    turns = np.tile(np.eye(3), (len(centers), 1, 1)) if rotations is None else rotations.as_matrix()
    out = np.tile(np.eye(4), (len(centers), 1, 1))
    out[:, :3, :3] = np.swapaxes(turns, 1, 2)
    out[:, :3, 3] = -np.einsum("nij,nj->ni", out[:, :3, :3], centers)
    return out


def in_another_world(path, scale, turn, shift):
    """The same cameras in a world that is scaled, turned and shifted."""
    centers = -np.einsum("nji,nj->ni", path[:, :3, :3], path[:, :3, 3])
    turns = turn * Rotation.from_matrix(np.swapaxes(path[:, :3, :3], 1, 2))
    return poses(scale * turn.apply(centers) + shift, turns)


def bent_path(count=8, seed=0):
    rng = np.random.default_rng(seed)
    return poses(rng.standard_normal((count, 3)), Rotation.from_rotvec(0.2 * rng.standard_normal((count, 3))))


def straight_path(count=8, direction=(1.0, 0.0, 0.0), seed=0):
    rng = np.random.default_rng(seed)
    line = np.linspace(-1, 1, count)[:, None] * np.asarray(direction)
    return poses(line, Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))))


TURN = Rotation.from_rotvec([0.4, -1.1, 2.0])
SHIFT = np.array([3.0, -2.0, 0.5])


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-4, 1e4), count=st.integers(3, 12))
@settings(max_examples=40, deadline=None)
def test_a_path_in_another_world_has_no_error(seed, scale, count):
    rng = np.random.default_rng(seed)
    path = bent_path(count, seed)
    errors = trajectory_errors(in_another_world(path, scale, Rotation.random(rng=rng), rng.standard_normal(3)), path)
    assert errors.ate == pytest.approx(0, abs=1e-9)
    assert errors.rotation_deg == pytest.approx(0, abs=1e-6)
    assert errors.rpe_t == pytest.approx(0, abs=1e-9)
    assert errors.rpe_r_deg == pytest.approx(0, abs=1e-6)
    assert errors.free == "nothing"


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 12), axis=st.sampled_from(np.eye(3).tolist()))
@settings(max_examples=40, deadline=None)
def test_a_straight_path_takes_its_roll_from_the_orientations(seed, count, axis):
    rng = np.random.default_rng(seed)
    path = straight_path(count, axis, seed)
    errors = trajectory_errors(in_another_world(path, 0.3, Rotation.random(rng=rng), SHIFT), path)
    assert errors.free == "roll"
    assert errors.ate == pytest.approx(0, abs=1e-9)
    assert errors.rotation_deg == pytest.approx(0, abs=1e-6)


def test_noise_across_a_straight_path_does_not_decide_its_roll():
    """Umeyama's rotation alone would be off by whatever angle turns one noise onto the other."""
    rng = np.random.default_rng(5)
    path = straight_path()
    noisy = path.copy()
    noisy[:, :3, 3] += 1e-4 * rng.standard_normal((8, 3))
    errors = trajectory_errors(in_another_world(noisy, 2.0, TURN, SHIFT), path)
    assert errors.free == "roll"
    assert errors.rotation_deg < 0.05
    assert errors.nate < 2e-4


def test_a_bend_well_above_the_residual_decides_the_roll():
    path = straight_path()
    path[:, 1, 3] += 0.05 * np.linspace(-1, 1, 8) ** 2
    assert align(path, path).free == "nothing"


@pytest.mark.parametrize("moving", ["estimate", "truth", "neither"])
def test_a_camera_that_stands_still_is_aligned_by_its_orientations(moving):
    turns = Rotation.from_rotvec(0.1 * np.random.default_rng(2).standard_normal((6, 3)))
    still, path = poses(np.tile([1.0, 2.0, 3.0], (6, 1)), turns), poses(straight_centers(6), turns)
    estimate, truth = (path if moving == "estimate" else still), (path if moving == "truth" else still)
    errors = trajectory_errors(in_another_world(estimate, 1.0, TURN, SHIFT), truth)
    assert errors.free == "rotation"
    assert errors.rotation_deg == pytest.approx(0, abs=1e-6)
    spread = np.sqrt(np.mean(np.sum(straight_centers(6) ** 2, 1)))
    assert errors.ate == pytest.approx(0 if moving == "neither" else spread, abs=1e-9)
    assert (errors.nate is None) == (moving != "truth")


def straight_centers(count):
    return np.linspace(-1, 1, count)[:, None] * [1.0, 0.0, 0.0]


def test_a_path_without_any_correlation_is_as_bad_as_no_motion():
    estimate = poses(np.array([1.0, -1.0, 1.0, -1.0])[:, None] * [1.0, 0.0, 0.0])
    truth = poses(np.array([1.0, 1.0, -1.0, -1.0])[:, None] * [1.0, 0.0, 0.0])
    assert align(estimate, truth).scale > 0
    errors = trajectory_errors(estimate, truth)
    assert errors.ate == pytest.approx(1.0)
    assert errors.nate == pytest.approx(0.5)
    assert errors.rotation_deg == pytest.approx(0, abs=1e-9)


def backwards(path):
    """The same orientations, the centres mirrored at their mean: the path of a scene inside out."""
    centers = -np.einsum("nji,nj->ni", path[:, :3, :3], path[:, :3, 3])
    return poses(2 * centers.mean(0) - centers, Rotation.from_matrix(np.swapaxes(path[:, :3, :3], 1, 2)))


def plane_path(count=8, seed=0):
    rng = np.random.default_rng(seed)
    centers = np.column_stack([np.linspace(-1, 1, count), 0.2 * np.linspace(-1, 1, count) ** 2, np.zeros(count)])
    return poses(centers, Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))))


@pytest.mark.parametrize("path", [straight_path(), straight_path(direction=(0, 0, 1.0)), plane_path()])
def test_a_path_that_runs_backwards_is_called_reversed_and_is_worse_than_none(path):
    """A half turn would bring its centres onto the true ones: the textbook's alignment sees no error at all."""
    errors = trajectory_errors(in_another_world(backwards(path), 0.4, TURN, SHIFT), path)
    assert errors.reversed
    assert errors.rotation_deg > 90
    assert errors.nate > 0.5
    assert not trajectory_errors(path, path).reversed


def test_a_reversed_path_is_drawn_at_its_size_and_with_the_cameras_upright():
    path = straight_path()
    alignment = align(in_another_world(backwards(path), 0.4, TURN, SHIFT), path)
    assert alignment.scale == pytest.approx(1 / 0.4)
    np.testing.assert_allclose(
        alignment.apply(in_another_world(backwards(path), 0.4, TURN, SHIFT)), backwards(path), atol=1e-9
    )


def test_a_single_view_has_no_path():
    errors = trajectory_errors(bent_path(1), bent_path(1, seed=4))
    assert (errors.ate, errors.nate, errors.rpe_t, errors.rpe_r_deg) == (
        pytest.approx(0, abs=1e-12),
        None,
        None,
        None,
    )
    assert errors.rotation_deg == pytest.approx(0, abs=1e-6)


def test_two_views_always_fit_but_their_orientations_tell():
    turned = poses(straight_centers(2), Rotation.from_rotvec([[0, 0.1, 0], [0, -0.1, 0]]))
    errors = trajectory_errors(turned, poses(straight_centers(2)))
    assert errors.ate == pytest.approx(0, abs=1e-12)
    assert errors.nate is None
    assert errors.rotation_deg == pytest.approx(np.degrees(0.1))
    assert errors.rpe_r_deg == pytest.approx(np.degrees(0.2))


def test_a_mirrored_path_is_not_turned_into_its_image():
    path = bent_path()
    centers = -np.einsum("nji,nj->ni", path[:, :3, :3], path[:, :3, 3])
    alignment = align(poses(centers * [1, 1, -1]), poses(centers))
    assert np.linalg.det(alignment.rotation) == pytest.approx(1)
    assert trajectory_errors(poses(centers * [1, 1, -1]), poses(centers)).nate > 0.01


def test_a_path_of_opposite_handedness_to_the_truth_has_a_positive_scale_or_none():
    """The four corners of a tetrahedron against its point reflection: nothing a rotation could explain fully."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
    alignment = align(poses(-corners), poses(corners))
    assert alignment.scale > 0
    assert np.linalg.det(alignment.rotation) == pytest.approx(1)


def test_a_planar_path_is_aligned_by_its_positions_alone():
    angle = np.linspace(0, np.pi, 7)
    arc = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    turned = poses(arc, Rotation.from_rotvec(np.tile([0, 0, 0.3], (7, 1))))
    errors = trajectory_errors(in_another_world(turned, 3.0, TURN, SHIFT), poses(arc))
    assert errors.free == "nothing"
    assert errors.rotation_deg == pytest.approx(np.degrees(0.3))


def test_errors_of_one_displaced_camera_are_those_computed_by_hand():
    """A square with a spike out of its plane at the centre: by symmetry nothing turns, only the scale gives."""
    square = np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]], np.float64)
    estimate = square.copy()
    estimate[:, 2] = [0.2, -0.2, 0.2, -0.2]
    scale = 8 / (8 + 4 * 0.04)
    gap = np.sqrt(2 * (1 - scale) ** 2 + (0.2 * scale) ** 2)
    errors = trajectory_errors(poses(estimate), poses(square))
    assert errors.ate == pytest.approx(gap)
    assert errors.translation_mean == pytest.approx(gap)
    assert errors.nate == pytest.approx(gap / np.sqrt(8))
    step = np.sqrt((2 * (1 - scale)) ** 2 + (0.4 * scale) ** 2)
    assert errors.rpe_t == pytest.approx(step)


def test_the_mean_translation_error_is_no_larger_than_its_root_mean_square():
    errors = trajectory_errors(bent_path(seed=1), bent_path(seed=2))
    assert 0.5 * errors.ate < errors.translation_mean < errors.ate


def test_ate_is_no_larger_than_under_any_other_similarity():
    truth, estimate = bent_path(seed=1), bent_path(seed=1)
    estimate[:, :3, 3] += 0.1 * np.random.default_rng(0).standard_normal((8, 3))
    best = align(estimate, truth)
    ate = trajectory_errors(estimate, truth).ate
    rng = np.random.default_rng(9)
    source, target = (-np.einsum("nji,nj->ni", p[:, :3, :3], p[:, :3, 3]) for p in (estimate, truth))
    for _ in range(50):
        nudge = Rotation.from_rotvec(0.02 * rng.standard_normal(3)).as_matrix()
        scale = best.scale * (1 + 0.02 * rng.standard_normal())
        moved = scale * source @ (nudge @ best.rotation).T
        moved += target.mean(0) - moved.mean(0)
        assert ate <= np.sqrt(np.mean(np.sum((moved - target) ** 2, 1))) + 1e-12


def test_applying_the_alignment_gives_the_true_poses():
    path = bent_path()
    moved = in_another_world(path, 0.2, TURN, SHIFT)
    np.testing.assert_allclose(align(moved, path).apply(moved), path, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi / 2, np.pi - 1e-6, np.pi])
def test_rotation_angles_are_precise_from_nothing_to_half_a_turn(angle):
    turn = Rotation.from_rotvec(angle * np.array([1, 2, -2]) / 3).as_matrix()
    assert rotation_angles_deg(turn) == pytest.approx(np.degrees(angle), rel=1e-9, abs=1e-12)


def test_float32_poses_of_a_camera_that_stands_still_count_as_still():
    still = poses(np.tile([10.0, -4.0, 2.0], (8, 1)), Rotation.from_rotvec(np.linspace(0, 1, 24).reshape(8, 3)))
    rounded = still.astype(np.float32).astype(np.float64)
    assert align(rounded, bent_path()).free == "rotation"


@pytest.mark.parametrize("shape", [(7, 4, 4), (8, 3, 4), (4, 4)])
def test_paths_of_another_shape_are_refused(shape):
    with pytest.raises(InputError, match="cannot be compared"):
        trajectory_errors(np.zeros(shape), bent_path())


def test_paths_without_a_pose_are_refused():
    with pytest.raises(InputError, match="cannot be compared"):
        align(np.zeros((0, 4, 4)), np.zeros((0, 4, 4)))


def test_a_path_that_is_not_finite_is_refused():
    path = bent_path()
    path[3, 0, 3] = np.nan
    with pytest.raises(InputError, match="NaN"):
        trajectory_errors(path, bent_path())


@pytest.mark.parametrize("factors", [(2, 2, 2), (-1, 1, 1), (0, 0, 0)])
def test_errors_against_poses_that_scale_or_mirror_are_refused(factors):
    truth = bent_path()
    truth[:, :3, :3] *= np.array(factors)[:, None]
    with pytest.raises(InputError, match="true poses are no rigid motions"):
        trajectory_errors(bent_path(), truth)
