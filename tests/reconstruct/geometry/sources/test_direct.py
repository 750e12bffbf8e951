"""Paths and depths that the measurement finds without tracks, and those that it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.direct import swept_along
from gs2ci.reconstruct.measurement.lens import Lens

# More points than there are: tracks say nothing.
TRACKLESS = GeometrySettings(sweep=SweepSettings(planes=48), criteria=Criteria(tracks=100_000))


def straight_path(views=5, shift=(0.06, 0.02, 0.0)):
    time = (np.arange(views) - views // 2)[:, None] / (views // 2)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, 3] = time * shift
    return poses


@pytest.fixture
def trackless(seen, expose):
    """Make views of a path, their measurement as a request, and what tracks find in them: nothing."""

    def make(poses=None, **parts):
        scene = seen(poses=straight_path() if poses is None else poses)
        request = Request(expose(scene, **parts), scene.views, TRACKLESS)
        found = initialise(scene.views, scene.intrinsics, TRACKLESS)
        assert (found.verdict, found.tracks, found.notes[-1]) == ("unsupported", 0, PLANE_NOTE)
        return scene, request, found

    return make


def test_depths_are_found_along_given_poses_of_any_frame_and_unit(trackless):
    scene, request, found = trackless()
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_rotvec((0.3, 1.0, -0.5)).as_matrix()
    frame[:3, 3] = (4, -2, 7)
    told = scene.poses.copy()
    told[:, :3, 3] *= 250
    along = swept_along(request, found, told @ frame)
    assert along is not None
    assert along.verdict == "full"
    assert PLANE_NOTE not in along.notes
    assert np.median(along.inverse_depth) == pytest.approx(1)
    # Depth and path are known up to one scale between them.
    scale = (along.world_to_camera[:, :3, 3] * scene.poses[:, :3, 3]).sum() / (scene.poses[:, :3, 3] ** 2).sum()
    np.testing.assert_allclose(along.world_to_camera[:, :3, 3], scale * scene.poses[:, :3, 3], atol=1e-9)
    error = np.abs(along.inverse_depth * scale / scene.inverse_depth - 1)
    assert np.median(error) < 0.05


def test_a_path_that_the_measurement_does_not_bear_out_is_refused(trackless):
    scene, request, found = trackless()
    backwards = scene.poses.copy()
    backwards[:, :3, 3] *= -1
    assert swept_along(request, found, backwards) is None
    assert swept_along(request, found, np.tile(np.eye(4), (5, 1, 1))) is None


def test_one_view_moves_nowhere(trackless, expose):
    scene, request, found = trackless()
    alone = replace(scene, views=scene.views[:1], poses=scene.poses[:1])
    request = Request(expose(alone), alone.views, TRACKLESS)
    found = initialise(alone.views, scene.intrinsics, TRACKLESS)
    assert swept_along(request, found, alone.poses) is None


def test_a_lens_and_a_mosaic_are_seen_through(trackless):
    """The picture is not bent: only that the canvas and the mosaic's pixels are gone through is looked at."""
    scene, request, found = trackless()
    rows, columns = np.indices(request.shot.size) % 2
    mosaic = np.take_along_axis(request.shot.measurement, (rows + columns)[..., None], axis=2)
    shot = replace(request.shot, measurement=mosaic, cfa="RGGB", distortion=np.array([0.02, 0, 0, 0, 0.0])).check()
    lens = Lens.of(shot)
    assert lens is not None
    behind = Request.of(shot, scene.views, TRACKLESS, lens)
    found = initialise(behind.views, behind.intrinsics, TRACKLESS)
    along = swept_along(behind, found, scene.poses)
    assert along is not None
    assert along.inverse_depth.shape == behind.size
