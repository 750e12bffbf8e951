from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.path.adjustment_kernels import (
    LEAST_RELATIVE_DEPTH,
    depth_steps,
    eliminate_depths,
    normal_blocks,
    solve_symmetric,
)
from gs2ci.reconstruct.geometry.path.motion import (
    MotionSettings,
    Sightings,
    adjust,
    adjust_both_ways,
    estimate_motion,
    predict_positions,
    residuals,
    reversed_depth,
    rms_px,
    start_motion,
    wander_px,
)

HUBER_PX = 1.0


def somewhere(scene, seed=0):
    """A motion near the truth, but not at it."""
    rng = np.random.default_rng(seed)
    motion = start_motion(Sightings.of(scene.tracks, scene.intrinsics))
    turn = Rotation.from_rotvec(0.01 * rng.normal(size=(len(scene.poses), 3))).as_matrix()
    return replace(
        motion,
        rotations=turn @ scene.poses[:, :3, :3],
        translations=scene.poses[:, :3, 3] + 0.01 * rng.normal(size=(len(scene.poses), 3)),
        inverse_depth=scene.inverse_depth * rng.uniform(0.8, 1.2, len(scene.inverse_depth)),
    )


def arguments(motion, sightings):
    return (
        motion.rotations,
        motion.translations,
        motion.inverse_depth,
        sightings.rays,
        sightings.seen_at,
        sightings.seen,
        sightings.focal_px,
        HUBER_PX,
    )


def jacobians(motion, sightings, points):
    """Differentiate the residuals.

    Args:
        motion: Where to differentiate.
        sightings: The tracks.
        points: Second result of `residuals` there.

    Returns:
        d r / d (ω, t), [N, P, 2, 6], for R ← exp(ω) R; and d r / d ρ, [N, P, 2].
    """
    fx, fy = sightings.focal_px
    inverse_z = 1 / np.maximum(points[..., 2], LEAST_RELATIVE_DEPTH)
    turned = points - motion.translations[:, None] * motion.inverse_depth[None, :, None]
    x, y, z = np.moveaxis(turned, -1, 0)
    # The rows of d r / d X are (ux, 0, uz) and (0, vy, vz).
    ux, uz = fx * inverse_z, -fx * points[..., 0] * inverse_z**2
    vy, vz = fy * inverse_z, -fy * points[..., 1] * inverse_z**2
    by_pose, rho = np.zeros((*points.shape[:2], 2, 6)), motion.inverse_depth
    # d(exp(ω) v)/dω = −[v]×, and row · −[v]× = v × row.
    by_pose[..., 0, 0], by_pose[..., 0, 1], by_pose[..., 0, 2] = y * uz, z * ux - x * uz, -y * ux
    by_pose[..., 1, 0], by_pose[..., 1, 1], by_pose[..., 1, 2] = y * vz - z * vy, -x * vz, x * vy
    by_pose[..., 0, 3], by_pose[..., 0, 5] = ux * rho, uz * rho
    by_pose[..., 1, 4], by_pose[..., 1, 5] = vy * rho, vz * rho
    tx, ty, tz = (motion.translations[:, k, None] for k in range(3))
    by_depth = np.stack([ux * tx + uz * tz, vy * ty + vz * tz], axis=-1)
    return by_pose, by_depth


def test_jacobian_agrees_with_finite_differences(tracked):
    scene = tracked(points=20, views=4, noise_px=0.5)
    sightings, motion, step = Sightings.of(scene.tracks, scene.intrinsics), somewhere(scene), 1e-6
    by_pose, by_depth = jacobians(motion, sightings, residuals(motion, sightings)[1])

    def difference(forth, back):
        return (residuals(forth, sightings)[0] - residuals(back, sightings)[0]) / (2 * step)

    for k in range(3):
        nudge = np.eye(3)[k] * step
        turned = [
            replace(motion, rotations=Rotation.from_rotvec(sign * nudge).as_matrix() @ motion.rotations)
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(by_pose[..., k], difference(*turned), rtol=1e-6, atol=1e-5)
        moved = [replace(motion, translations=motion.translations + sign * nudge) for sign in (1, -1)]
        np.testing.assert_allclose(by_pose[..., 3 + k], difference(*moved), rtol=1e-6, atol=1e-5)
    nearer = [replace(motion, inverse_depth=motion.inverse_depth + sign * step) for sign in (1, -1)]
    np.testing.assert_allclose(by_depth, difference(*nearer), rtol=1e-6, atol=1e-5)


def test_kernel_blocks_are_the_weighted_normal_equations_of_that_jacobian(tracked):
    scene = tracked(points=15, views=4, noise_px=2.0, missing=0.2)
    sightings, motion = Sightings.of(scene.tracks, scene.intrinsics), somewhere(scene)
    views, points = sightings.seen.shape
    error, at = residuals(motion, sightings)
    by_pose, by_depth = jacobians(motion, sightings, at)
    distance = np.linalg.norm(error, axis=-1)
    weight = np.where(distance < HUBER_PX, 1, HUBER_PX / distance) * sightings.seen
    jacobian = np.zeros((views, points, 2, 6 * views + points))
    for i in range(views):
        jacobian[i, :, :, 6 * i : 6 * i + 6] = by_pose[i]
        for p in range(points):
            jacobian[i, p, :, 6 * views + p] = by_depth[i, p]
    dense = jacobian.reshape(-1, 6 * views + points)
    weights = np.repeat(weight.reshape(-1), 2)
    normal, right = dense.T @ (weights[:, None] * dense), -dense.T @ (weights * error.reshape(-1))
    _, A, b, C, d, E = normal_blocks(*arguments(motion, sightings))
    n = 6 * views
    for i in range(views):
        block = slice(6 * i, 6 * i + 6)
        np.testing.assert_allclose(A[i], normal[block, block], rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(b.reshape(-1), right[:n], rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(np.diag(C), normal[n:, n:], rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(d, right[n:], rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(E, normal[n:, :n], rtol=1e-9, atol=1e-7)


def test_elimination_solves_the_whole_system(tracked):
    scene = tracked(points=12, views=3, noise_px=1.0)
    blocks = normal_blocks(*arguments(somewhere(scene), Sightings.of(scene.tracks, scene.intrinsics)))
    _, A, b, C, d, E = blocks
    A, C = A + 10 * np.eye(6), C + 1.0
    n = 6 * len(A)
    whole = np.block([[np.zeros((n, n)), E.T], [E, np.diag(C)]])
    for i in range(len(A)):
        whole[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = A[i]
    expected = np.linalg.solve(whole, np.concatenate([b.reshape(-1), d]))
    system, poses = eliminate_depths(A, b, C, d, E)
    assert solve_symmetric(system, poses)
    np.testing.assert_allclose(poses, expected[:n], rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(depth_steps(C, d, E, poses), expected[n:], rtol=1e-7, atol=1e-10)


def test_a_system_that_is_not_positive_definite_is_not_solved():
    assert not solve_symmetric(np.diag([1.0, -1.0]), np.ones(2))
    assert not solve_symmetric(np.full((2, 2), np.nan), np.ones(2))


def test_cost_is_quadratic_near_and_linear_far(tracked):
    scene = tracked(points=30, views=3, noise_px=2.0)
    sightings, motion = Sightings.of(scene.tracks, scene.intrinsics), somewhere(scene)
    distance = np.linalg.norm(residuals(motion, sightings)[0], axis=-1)[sightings.seen]
    expected = np.where(distance < HUBER_PX, distance**2 / 2, HUBER_PX * distance - HUBER_PX**2 / 2).sum()
    assert normal_blocks(*arguments(motion, sightings))[0] == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(4))
def test_exact_tracks_give_the_exact_path_and_depths(tracked, compare, seed):
    scene = tracked(seed=seed)
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics, MotionSettings(tolerance=1e-12, iterations=300))
    path_error, rotation_error_deg = compare
    assert len(kept) == len(scene.tracks)
    assert path_error(motion.world_to_camera, scene.poses) < 1e-3
    assert rotation_error_deg(motion.world_to_camera, scene.poses) < 0.02
    ratio = motion.inverse_depth / scene.inverse_depth
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_noise_and_outliers_are_survived(tracked, compare, seed):
    scene = tracked(seed=seed, noise_px=0.4, outliers=0.3, missing=0.1)
    motion, kept = estimate_motion(scene.tracks.seen_by_at_least(5), scene.intrinsics)
    assert compare[0](motion.world_to_camera, scene.poses) < 0.05
    assert 0.5 * len(scene.tracks) < len(kept) < 0.95 * len(scene.tracks)
    assert motion.rms_px < 1
    assert motion.behind_share == 0


def test_median_inverse_depth_is_one_and_the_reference_view_is_the_world(tracked):
    scene = tracked(noise_px=0.2)
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    assert np.median(motion.inverse_depth) == pytest.approx(1)
    np.testing.assert_array_equal(motion.world_to_camera[kept.reference], np.eye(4))


def test_two_views_are_enough(tracked, compare):
    scene = tracked(views=2)
    motion, _ = estimate_motion(scene.tracks, scene.intrinsics)
    assert motion.rms_px < 0.01
    assert compare[1](motion.world_to_camera, scene.poses) < 0.1


def test_same_tracks_give_the_same_bits(tracked):
    scene = tracked(noise_px=0.5)
    a, b = (estimate_motion(scene.tracks, scene.intrinsics)[0] for _ in range(2))
    np.testing.assert_array_equal(a.world_to_camera, b.world_to_camera)
    np.testing.assert_array_equal(a.inverse_depth, b.inverse_depth)


@pytest.fixture
def distant(tracked, path):
    """A narrow field of view and little motion: nothing but noise-free second order tells near from far."""
    poses = path(8, np.random.default_rng(0), length=0.005, turn=0.001)
    return tracked(focal=3000.0, poses=poses, noise_px=0.02)


def test_reversal_explains_the_tracks_of_a_distant_camera_to_first_order(distant):
    sightings = Sightings.of(distant.tracks, distant.intrinsics)
    turned_over = reversed_depth(adjust(distant.tracks, distant.intrinsics))
    distance = np.linalg.norm(residuals(turned_over, sightings)[0], axis=-1)[sightings.seen]
    unmoved = np.linalg.norm(residuals(start_motion(sightings), sightings)[0], axis=-1)[sightings.seen]
    assert np.median(distance) < 0.15 * np.median(unmoved)


def test_the_reversed_scene_is_a_trap_and_reversal_the_way_out(distant, compare):
    right = adjust_both_ways(distant.tracks, distant.intrinsics)
    trapped = adjust(distant.tracks, distant.intrinsics, start=reversed_depth(right))
    assert trapped.cost > 2 * right.cost
    freed = adjust(distant.tracks, distant.intrinsics, start=reversed_depth(trapped))
    assert freed.cost < 1.5 * right.cost
    assert compare[0](right.world_to_camera, distant.poses) < 0.05


def test_points_at_infinity_keep_everything_finite(tracked):
    scene = tracked()
    far = replace(scene.tracks)
    far.positions[:100] = predict_positions(
        scene.tracks.positions[:100, far.reference], np.zeros(100), scene.poses, scene.intrinsics
    )
    motion, _ = estimate_motion(far, scene.intrinsics)
    assert np.isfinite(motion.world_to_camera).all()
    assert (motion.inverse_depth > 0).all()


def test_a_single_track_keeps_everything_finite(tracked):
    scene = tracked(points=1)
    motion, _ = estimate_motion(scene.tracks, scene.intrinsics)
    assert np.isfinite(motion.world_to_camera).all()


def test_rms_counts_only_what_was_seen():
    assert rms_px(np.array([[[3.0, 4.0], [np.nan, np.nan]]])) == 5.0
    assert rms_px(np.full((2, 3, 2), np.nan)) == 0.0


def test_wander_ignores_what_shifts_a_whole_track():
    rng = np.random.default_rng(0)
    shift = rng.normal(size=(50, 1, 2)) * np.ones((1, 6, 1))
    assert wander_px(shift) == pytest.approx(0, abs=1e-12)
    noise = rng.normal(size=(4000, 6, 2))
    assert wander_px(shift[:1] + noise) == pytest.approx(np.sqrt(2), rel=0.02)
    assert wander_px(noise, unknowns=1) == pytest.approx(np.sqrt(2 * 10 / 9), rel=0.02)
    assert wander_px(noise[:, :1]) == 0.0
