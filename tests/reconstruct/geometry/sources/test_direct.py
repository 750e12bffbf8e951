"""Paths and depths that the measurement finds without tracks, and those that it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.direct import Direct
from gs2ci.reconstruct.measurement.lens import Lens

# More points than there are: tracks say nothing.
TRACKLESS = GeometrySettings(sweep=SweepSettings(planes=48), criteria=Criteria(tracks=100_000))


def uniform_path(views=5, shift=(0.06, 0.02, 0.0), turn_deg=(0.0, 0.0, 0.0)):
    time = (np.arange(views) - views // 2)[:, None] / (views // 2)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(time * turn_deg, degrees=True).as_matrix()
    poses[:, :3, 3] = time * shift
    return poses


@pytest.fixture
def trackless(seen, expose):
    """Make views of a path, their measurement as a request, and what tracks find in them: nothing."""

    def make(poses=None, **parts):
        scene = seen(poses=uniform_path() if poses is None else poses)
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
    along = Direct(request, found).along(told @ frame)
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
    assert Direct(request, found).along(backwards) is None
    assert Direct(request, found).along(np.tile(np.eye(4), (5, 1, 1))) is None


@pytest.mark.parametrize("shift", [(0.06, 0.02, 0.0), (-0.01, -0.06, 0.01)])
def test_a_uniform_motion_is_found_from_nothing(trackless, shift):
    scene, request, found = trackless(uniform_path(shift=shift, turn_deg=(0.3, -0.4, 0.5)))
    uniform = Direct(request, found).uniform()
    assert uniform.verdict == "full"
    assert [note.code for note in uniform.path_notes] == [Code.UNIFORM_MOTION]
    ends = uniform.world_to_camera[-1, :3, 3] - uniform.world_to_camera[0, :3, 3]
    cosine = ends @ shift / np.linalg.norm(ends) / np.linalg.norm(shift)
    assert cosine > np.cos(np.radians(15))
    left, rest = (unexplained(request.shot, scene.views, one) for one in (uniform, found))
    assert left < 0.7 * rest


def test_a_camera_that_only_turned_is_found_to_have_turned(trackless):
    scene, request, found = trackless(uniform_path(shift=(0, 0, 0), turn_deg=(1.0, -2.0, 1.5)))
    turned = Direct(request, found).uniform()
    assert turned.verdict == "rotation_only"
    assert turned.notes[-1] == PLANE_NOTE
    off = turned.world_to_camera[:, :3, :3] @ scene.poses[:, :3, :3].transpose(0, 2, 1)
    assert np.degrees(Rotation.from_matrix(off).magnitude()).max() < 0.3
    assert np.all(turned.inverse_depth == 1)


def test_a_camera_that_stayed_is_left_at_rest(trackless):
    _, request, found = trackless(np.tile(np.eye(4), (5, 1, 1)))
    still = Direct(request, found).uniform()
    assert (still.verdict, still.tracks) == ("unsupported", 0)
    assert np.array_equal(still.world_to_camera, np.tile(np.eye(4), (5, 1, 1)))
    assert still.notes[-1] == PLANE_NOTE


def test_one_view_moves_nowhere(trackless, expose):
    scene, request, found = trackless()
    alone = replace(scene, views=scene.views[:1], poses=scene.poses[:1])
    request = Request(expose(alone), alone.views, TRACKLESS)
    found = initialise(alone.views, scene.intrinsics, TRACKLESS)
    assert Direct(request, found).along(alone.poses) is None
    still = Direct(request, found).uniform()
    assert (still.verdict, still.notes[-1]) == ("unsupported", PLANE_NOTE)


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
    uniform = Direct(behind, found).uniform()
    assert uniform.verdict == "full"
    assert uniform.inverse_depth.shape == behind.size


def test_the_same_measurement_gives_the_same_motion(trackless):
    _, request, found = trackless()
    first, second = (Direct(request, found).uniform() for _ in range(2))
    assert np.array_equal(first.world_to_camera, second.world_to_camera)
    assert np.array_equal(first.inverse_depth, second.inverse_depth)
