"""The plane sweep against its plain statement in numpy float64, and on scenes of known depth."""

import numba
import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.geometry.depth import kernels
from gs2ci.reconstruct.geometry.depth.eight import FEATURES
from gs2ci.reconstruct.geometry.depth.kernels import best_plane, matching_cost, smoothed
from gs2ci.reconstruct.geometry.depth.sweep import (
    SweepSettings,
    SweptViews,
    first_of,
    inverse_depth_range,
    sweep,
)


def cost_reference(reference, views, homographies, best, window):
    """[H, W, F], [V, H, W, F], [D, V, 3, 3] -> [H, W, D]."""
    height, width = reference.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    targets = np.einsum("dvij,jhw->dvihw", homographies, np.stack([x, y, np.ones_like(x)]))
    return np.stack([cost_at(reference, views, places, best, window) for places in targets], axis=-1)


def cost_at(reference, views, targets, best, window):
    """[H, W, F], [V, H, W, F] at homogeneous places [V, 3, H, W] -> [H, W]."""
    height, width = reference.shape[:2]
    windows = []
    for view, (x, y, z) in zip(views, targets, strict=True):
        u, v = x / z, y / z
        unseen = (u < 0) | (u > width - 1) | (v < 0) | (v > height - 1) | (z < 1e-3)
        col, row = np.clip(u.astype(int), 0, width - 2), np.clip(v.astype(int), 0, height - 2)
        a, b = (u - col)[..., None], (v - row)[..., None]
        upper = (1 - a) * view[row, col] + a * view[row, col + 1]
        lower = (1 - a) * view[row + 1, col] + a * view[row + 1, col + 1]
        difference = np.abs((1 - b) * upper + b * lower - reference).sum(-1)
        difference = np.where(unseen, kernels.UNSEEN_COST, np.minimum(difference, kernels.TRUNCATED_AT))
        windows.append(box_mean(difference, window // 2))
    return np.sort(windows, axis=0)[:best].mean(0)


def cost_of(reference, others, homographies, best, window):
    """The kernel's, of the same features behind one another in another order."""
    count = len(others)
    views = np.concatenate([others[::-1], reference[None]])
    return matching_cost(views, [count, *reversed(range(count))], homographies, best, window)


def box_mean(image, reach):
    out = np.empty_like(image)
    for r in range(image.shape[0]):
        for c in range(image.shape[1]):
            out[r, c] = image[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1].mean()
    return out


def path_costs_reference(cost, axis, backwards):
    cost = np.flip(np.moveaxis(cost, axis, 0), 0) if backwards else np.moveaxis(cost, axis, 0)
    paths = cost.copy()
    for i in range(1, len(cost)):
        before = paths[i - 1]
        least = before.min(-1, keepdims=True)
        padded = np.pad(before, ((0, 0), (1, 1)), constant_values=np.inf)
        step = np.minimum(padded[:, :-2], padded[:, 2:]) + kernels.SMALL_JUMP
        paths[i] = cost[i] + np.minimum(np.minimum(before, step), least + kernels.LARGE_JUMP) - least
    return np.moveaxis(np.flip(paths, 0) if backwards else paths, 0, axis)


def random_case(height=21, width=39, views=4, planes=7, seed=0):
    rng = np.random.default_rng(seed)
    reference = rng.random((height, width, FEATURES)).astype(np.float32) * 0.2
    others = rng.random((views, height, width, FEATURES)).astype(np.float32) * 0.2
    homographies = np.tile(np.eye(3), (planes, views, 1, 1))
    homographies[..., :2, 2] = rng.uniform(-3, 3, (planes, views, 2))
    homographies[..., 2, :2] = rng.uniform(-1e-3, 1e-3, (planes, views, 2))
    return reference, others, homographies


@pytest.mark.parametrize(("height", "width"), [(21, 39), (70, 5), (4, 4), (2, 2), (33, 32)])
@pytest.mark.parametrize(("best", "window"), [(1, 7), (3, 7), (2, 1), (2, 3), (2, 41)])
def test_matching_cost_agrees_with_its_reference(height, width, best, window):
    reference, others, homographies = random_case(height, width)
    expected = cost_reference(reference.astype(np.float64), others.astype(np.float64), homographies, best, window)
    np.testing.assert_allclose(cost_of(reference, others, homographies, best, window), expected, atol=2e-5)


def test_planes_behind_a_camera_count_as_unseen():
    reference, others, homographies = random_case()
    homographies[:, :, 2, 2] = -1
    np.testing.assert_allclose(cost_of(reference, others, homographies, 2, 7), kernels.UNSEEN_COST, rtol=1e-5)


@pytest.mark.parametrize("shape", [(9, 40, 6), (1, 5, 3), (40, 1, 12)])
def test_semi_global_smoothing_agrees_with_its_reference(shape):
    cost = np.random.default_rng(0).random(shape).astype(np.float32)
    double = cost.astype(np.float64)
    total = sum(path_costs_reference(double, axis, back) for axis in (1, 0) for back in (False, True))
    got = smoothed(cost)
    np.testing.assert_allclose(got, total, rtol=1e-5)
    index = best_plane(torch.from_numpy(got)).numpy()
    best = total.argmin(-1)
    inner = (best > 0) & (best < shape[2] - 1)
    at = np.clip(best, 1, shape[2] - 2)[..., None]
    before, here, after = (np.take_along_axis(total, at + k, -1)[..., 0] for k in (-1, 0, 1))
    valley = at[..., 0] + (before - after) / (2 * (before - 2 * here + after))
    np.testing.assert_allclose(index[inner], valley[inner], atol=1e-3)
    assert (np.abs(index - best) <= 0.5 + 1e-6)[inner].all()


def test_a_flat_cost_gives_a_finite_plane():
    cost = np.zeros((4, 5, 6), np.float32)
    assert best_plane(torch.from_numpy(smoothed(cost))).isfinite().all()


def test_threads_do_not_change_a_bit():
    reference, others, homographies = random_case(70, 70)
    before, results = numba.get_num_threads(), []
    try:
        for threads in (1, min(2, before)):
            numba.set_num_threads(threads)
            cost = cost_of(reference, others, homographies, 2, 7)
            results.append(best_plane(torch.from_numpy(smoothed(cost))).numpy())
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*results)


def swept(scene, settings=None, span=(0.05, 2.0)):
    return sweep(scene.views, scene.poses, scene.intrinsics, len(scene.views) // 2, span, settings or SweepSettings())


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("views", [2, 3, 5])
def test_two_planes_are_found_at_their_depths(seen, channels, views):
    scene = seen(views=views, channels=channels)
    error = np.abs(swept(scene) - scene.inverse_depth) / scene.inverse_depth
    assert np.median(error) < 0.03
    assert np.mean(error > 0.2) < 0.12  # the panel's rim


def test_a_reduced_sweep_still_finds_them(seen):
    scene = seen()
    got = swept(scene, SweepSettings(planes=48, most_pixels=2700))
    assert got.shape == scene.inverse_depth.shape
    error = np.abs(got - scene.inverse_depth) / scene.inverse_depth
    assert np.median(error) < 0.06


@pytest.mark.parametrize("size", [(1, 1), (3, 50), (16, 16)])
def test_small_images_are_swept(seen, size):
    scene = seen(size=(20, 60))
    views = np.ascontiguousarray(scene.views[:, : size[0], : size[1]])
    got = sweep(views, scene.poses, scene.intrinsics, 2, (0.1, 1.0), SweepSettings(planes=3))
    assert got.shape == size
    assert got.min() >= 0.1 - 1e-6
    assert got.max() <= 1.0 + 1e-6


def test_views_without_texture_give_a_finite_depth(seen):
    scene = seen()
    scene.views[:] = 0.5
    assert np.isfinite(swept(scene)).all()


@pytest.mark.parametrize("window_px", [1, 15])
def test_two_planes_are_found_through_other_windows(seen, window_px):
    scene = seen()
    error = np.abs(swept(scene, SweepSettings(window_px=window_px)) - scene.inverse_depth) / scene.inverse_depth
    assert np.median(error) < 0.05


@pytest.mark.parametrize("window_px", [0, 6, -7, 257])
def test_a_window_without_a_middle_or_out_of_range_is_refused(window_px):
    with pytest.raises(InputError, match=f"window_px = {window_px} in SweepSettings"):
        SweepSettings(window_px=window_px).check()


@pytest.mark.parametrize("blur_px", [0.0, -1.0, np.nan, np.inf])
def test_a_blur_that_is_none_is_refused(blur_px):
    with pytest.raises(InputError, match=r"blur_px = .* in SweepSettings"):
        SweepSettings(blur_px=blur_px).check()


def test_fewer_planes_than_a_parabola_needs_are_refused():
    with pytest.raises(InputError, match="planes = 2 in SweepSettings"):
        SweepSettings(planes=2).check()


def test_range_reaches_from_near_infinity_to_beyond_the_nearest_track():
    far, near = inverse_depth_range(np.linspace(0.5, 1.5, 101), SweepSettings())
    assert far == pytest.approx(0.03)
    assert near == pytest.approx(1.25 * 1.49)


SIZE = (72, 96)
FOCAL = 90.0
INTRINSICS = np.array([[FOCAL, 0, 48], [0, FOCAL, 36], [0, 0, 1.0]])
SPAN, SETTINGS = (0.1, 1.2), SweepSettings(planes=48)
NEAR, FAR = 0.8, 0.3
REFERENCE = 3


def poses(count: int) -> np.ndarray:
    """Return poses that travel to the right, the reference at the origin, [N, 4, 4]."""
    found = np.repeat(np.eye(4)[None], count, axis=0)
    found[:, 0, 3] = -0.05 * (np.arange(count) - REFERENCE)
    return found


def thing_before_a_wall(count: int) -> np.ndarray:
    """Show a textured thing, 20 columns wide, before a wall that is plain beside it and hardly textured beyond."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    views = []
    for pose in poses(count):
        there, here = (columns - FOCAL * pose[0, 3] * depth for depth in (FAR, NEAR))
        beyond = np.abs(there - 48) > 18
        view = np.full((*SIZE, 3), 0.3)
        view[beyond] += 0.02 * (np.sin(0.9 * there) * np.sin(0.7 * rows))[beyond][:, None]
        inside = np.abs(here - 48) < 10
        view[inside] = 0.7 + 0.2 * (np.sin(0.8 * rows) * np.cos(1.1 * here))[inside][:, None]
        views.append(view + rng.normal(0, 2e-3, view.shape))
    return np.stack(views).astype(np.float32)


def test_two_views_are_enough():
    views = thing_before_a_wall(5)[[REFERENCE, REFERENCE + 1]]
    found = sweep(views, poses(5)[[REFERENCE, REFERENCE + 1]], INTRINSICS, 0, SPAN, SETTINGS)
    assert np.isfinite(found).all()


def test_views_described_once_are_swept_as_some_of_them_alone():
    views, path, order = thing_before_a_wall(5), poses(5), [1, 4, 2]
    described = SweptViews(views, SETTINGS)
    from_view = path[order] @ np.linalg.inv(path[order[0]])
    alone = sweep(views[order], from_view, INTRINSICS, 0, SPAN, SETTINGS)
    np.testing.assert_array_equal(described.depth(order, from_view, INTRINSICS, SPAN), alone)
    whole = described.depth(first_of(5, REFERENCE), path[first_of(5, REFERENCE)], INTRINSICS, SPAN)
    np.testing.assert_array_equal(whole, sweep(views, path, INTRINSICS, REFERENCE, SPAN, SETTINGS))


def test_a_dark_scene_has_the_depth_of_a_bright_one():
    """By a power of two, so that every product is exact: the penalties of a map are in full scales."""
    views, there = thing_before_a_wall(5), (poses(5), INTRINSICS, REFERENCE, SPAN, SETTINGS)
    bright, dark = (sweep(shown, *there) for shown in (views, views / np.float32(32)))
    np.testing.assert_array_equal(dark, bright)
