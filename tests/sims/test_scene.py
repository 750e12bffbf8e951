import dataclasses

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.scene import camera_looking_ahead


def test_a_scene_tells_its_median_depth_and_its_range(small_scene):
    depth = np.full(small_scene.size, 4.0)
    depth[:10] = 2.0
    depth[0, 0] = np.nan
    scene = dataclasses.replace(small_scene, depth=depth)
    assert scene.median_depth == 4.0
    assert scene.depth_range() == (2.0, 4.0)


def test_the_range_of_depths_leaves_out_one_percent_at_either_end(small_scene):
    depth = np.linspace(1.0, 101.0, small_scene.depth.size).reshape(small_scene.size)
    assert dataclasses.replace(small_scene, depth=depth).depth_range() == pytest.approx((2.0, 100.0))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"depth": np.ones((3, 3))}, "depth map"),
        ({"size": (0, 0), "depth": np.ones((0, 0))}, "image size"),
        ({"depth": np.full((48, 64), np.nan)}, "nothing in front"),
        ({"depth": np.full((48, 64), -1.0)}, "nothing in front"),
        ({"intrinsics": np.zeros((3, 3))}, "intrinsics"),
        ({"world_to_camera": np.eye(3)}, "camera pose"),
        ({"world_to_camera": np.full((4, 4), np.nan)}, "camera pose"),
        ({"world_to_camera": np.diag([2.0, 2.0, 2.0, 1.0])}, "rigid"),
        ({"world_to_camera": np.diag([-1.0, 1.0, 1.0, 1.0])}, "rigid"),
        # A translation in the last row: the transposed matrix.
        ({"world_to_camera": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 2, 1]])}, "rigid"),
    ],
)
def test_scenes_that_contradict_themselves_are_refused(small_scene, changes, problem):
    with pytest.raises(InputError, match=problem):
        dataclasses.replace(small_scene, **changes)


def test_a_centred_camera_sees_its_field_of_view():
    intrinsics = camera_looking_ahead((100, 200), 90.0)
    assert intrinsics == pytest.approx(np.array([[100.0, 0, 100], [0, 100.0, 50], [0, 0, 1]]))


@pytest.mark.parametrize("angle", [0.0, 180.0, float("nan")])
def test_a_field_of_view_without_meaning_is_refused(angle):
    with pytest.raises(InputError, match="field of view"):
        camera_looking_ahead((100, 200), angle)
