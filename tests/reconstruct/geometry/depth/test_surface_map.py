"""A view's depth map."""

import numpy as np

from gs2ci.reconstruct.geometry.depth.surface_map import surface_map
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings

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


def seen(count: int) -> np.ndarray:
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
    views = seen(5)[[REFERENCE, REFERENCE + 1]]
    found = surface_map(views, poses(5)[[REFERENCE, REFERENCE + 1]], INTRINSICS, 0, SPAN, SETTINGS)
    assert np.isfinite(found).all()


def test_a_dark_scene_has_the_depth_of_a_bright_one():
    """By a power of two, so that every product is exact: the penalties of a map are in full scales."""
    views, there = seen(5), (poses(5), INTRINSICS, REFERENCE, SPAN, SETTINGS)
    bright, dark = (surface_map(shown, *there) for shown in (views, views / np.float32(32)))
    np.testing.assert_array_equal(dark, bright)
