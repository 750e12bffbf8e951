from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.points import seed_points


def geometry_of(scene, verdict="full"):
    return Geometry(
        world_to_camera=scene.poses,
        intrinsics=scene.intrinsics,
        focal_source="file",
        inverse_depth=scene.inverse_depth,
        reference=len(scene.views) // 2,
        tracks=100,
        reprojection_rms_px=0.1,
        parallax_px=1.0,
        verdict=verdict,
        notes=(),
    )


def project(points, pose, intrinsics):
    camera = (points @ pose[:3, :3].T + pose[:3, 3]) @ intrinsics.T
    return camera[:, :2] / camera[:, 2:]


def inside(pixels, size):
    return ((pixels >= 0) & (pixels < (size[1], size[0]))).all(1)


@pytest.mark.parametrize("stride", [1, 3, 4])
def test_points_of_the_reference_view_project_back_to_their_pixel_centres(seen, stride):
    scene = seen()
    seeds = seed_points(geometry_of(scene), scene.views, stride)
    y, x = np.mgrid[0:90:stride, 0:120:stride]
    count = x.size
    pixels = project(seeds.positions[:count], np.eye(4), scene.intrinsics)
    np.testing.assert_allclose(pixels, np.stack([x.ravel(), y.ravel()], 1) + 0.5, atol=1e-3)
    np.testing.assert_array_equal(seeds.colours[:count], scene.views[2][y.ravel(), x.ravel()])
    np.testing.assert_allclose(1 / seeds.positions[:count, 2], scene.inverse_depth[y.ravel(), x.ravel()], rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_rims_hold_what_only_other_views_see_whatever_the_motion(seen, path, seed):
    poses = path(5, np.random.default_rng(seed), length=0.12, turn=0.0)
    scene = seen(poses=poses, depths=(1.0, 1.0))  # nothing hides behind anything
    seeds = seed_points(geometry_of(scene), scene.views)
    rim = seeds.positions[30 * 40 :]
    assert len(rim) > 50
    assert not inside(project(rim, np.eye(4), scene.intrinsics), (90, 120)).any()
    for pose in scene.poses:
        seen_pixels = project(seeds.positions, pose, scene.intrinsics)
        cells = np.unique((seen_pixels[inside(seen_pixels, (90, 120))] / 10).astype(int), axis=0)
        assert len(cells) == 9 * 12


def test_spacing_is_the_stride_at_the_depth_of_the_point(seen):
    scene = seen()
    seeds = seed_points(geometry_of(scene), scene.views, stride=3)
    np.testing.assert_allclose(seeds.spacing[:1200], 3 / 100 * seeds.positions[:1200, 2], rtol=1e-4)


def test_a_still_camera_has_no_rims(seen):
    scene = seen(poses=np.tile(np.eye(4), (5, 1, 1)))
    assert len(seed_points(geometry_of(scene, "static"), scene.views).positions) == 30 * 40


def test_mono_views_give_mono_colours_and_two_views_suffice(seen):
    scene = seen(views=2, channels=1)
    seeds = seed_points(geometry_of(scene), scene.views)
    assert seeds.colours.shape == (len(seeds.positions), 1)
    assert seeds.positions.dtype == seeds.spacing.dtype == np.float32


@pytest.mark.parametrize(("factor", "new"), [(1.0, 0), (1.02, 0), (1.05, 1), (0.5, 1)])
def test_points_of_further_views_are_added_where_their_depth_is_another(seen, factor, new):
    """A camera that moved along its axis before one wall, so that every pixel of the nearer view is in both."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[2, 2, 3] = -0.25
    wall = replace(geometry_of(seen(views=3)), world_to_camera=poses, inverse_depth=np.ones((90, 120), np.float32))
    nearer = ViewDepth(2, np.full((90, 120), factor / 0.75, np.float32))
    views = np.random.default_rng(0).random((3, 90, 120, 3)).astype(np.float32)
    alone = seed_points(wall, views)
    both = seed_points(replace(wall, view_depths=(ViewDepth(1, wall.inverse_depth), nearer)), views)
    pixels = 30 * 40
    np.testing.assert_array_equal(both.positions[:pixels], alone.positions[:pixels])
    assert len(both.positions) - len(alone.positions) == new * pixels
    if new:
        added = slice(pixels, 2 * pixels)
        np.testing.assert_allclose(both.positions[added, 2], 0.25 + 0.75 / factor, rtol=1e-5)
        np.testing.assert_array_equal(both.colours[added], views[2, ::3, ::3].reshape(-1, 3))
        np.testing.assert_allclose(both.spacing[added], both.spacing[0] * 0.75 / factor, rtol=1e-5)


def test_a_further_view_that_sees_behind_the_middle_one_adds_all_it_sees(seen):
    scene = seen(views=3)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[2] = np.diag([-1.0, 1, -1, 1])
    poses[2, 2, 3] = 4  # on the other side of the wall, looking back
    geometry = replace(geometry_of(scene), world_to_camera=poses, inverse_depth=np.ones((90, 120), np.float32))
    back = ViewDepth(2, np.ones((90, 120), np.float32))
    found = seed_points(replace(geometry, view_depths=(ViewDepth(1, geometry.inverse_depth), back)), scene.views)
    beyond = found.positions[:, 2] > 2
    assert beyond.sum() == 30 * 40
    np.testing.assert_allclose(found.positions[beyond, 2], 3, rtol=1e-6)
