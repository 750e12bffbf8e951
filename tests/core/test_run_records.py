from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.run_records import RunResult


@pytest.fixture
def result() -> RunResult:
    views = np.full((2, 4, 5, 3), 0.5, np.float32)
    return RunResult(
        views=views,
        scene_views=views,
        depth=np.ones((2, 4, 5), np.float32),
        world_to_camera=np.tile(np.eye(4), (2, 1, 1)),
        intrinsics=np.array([[5.0, 0, 2.5], [0, 5.0, 2], [0, 0, 1]]),
        decode=0.5 * views,
        predicted_measurement=np.ones((4, 5, 3), np.float32),
        curve=(),
        stopped=finding(Code.FIT_ALL_DONE_UNJUDGED, iterations=0),
        seconds={"total": 1.0, "decode": 1.0, "geometry": 0.0, "fit": 0.0},
        gaussians=0,
        notes=(),
        settings={},
        seed=0,
        verdict="scene",
        heldout_rms={"refined": None, "scene": None, "decode": None},
    )


def test_a_whole_result_passes(result):
    assert result.check() is result
    assert replace(result, depth=None).check().depth is None


@pytest.mark.parametrize(
    ("part", "shape"),
    [
        ("depth", (2, 4, 6)),
        ("scene_views", (2, 4, 5, 1)),
        ("world_to_camera", (3, 4, 4)),
        ("decode", (2, 4, 5, 1)),
        ("predicted_measurement", (4, 6, 3)),
    ],
)
def test_parts_of_other_shapes_are_refused(result, part, shape):
    with pytest.raises(InputError, match=part):
        replace(result, **{part: np.zeros(shape)}).check()


@pytest.mark.parametrize("shape", [(4, 5, 3), (2, 4, 5, 2)])
def test_views_that_are_no_stack_of_images_are_refused(result, shape):
    with pytest.raises(InputError, match="views have shape"):
        replace(result, views=np.zeros(shape, np.float32)).check()


@pytest.mark.parametrize("part", ["views", "depth", "world_to_camera", "decode", "predicted_measurement"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_refused(result, part, value):
    array = getattr(result, part).copy()
    array.flat[3] = value
    with pytest.raises(NumericsError, match=part):
        replace(result, **{part: array}).check()


def test_a_missing_time_is_refused(result):
    with pytest.raises(InputError, match="geometry, fit"):
        replace(result, seconds={"total": 1.0, "decode": 1.0}).check()


def test_an_unknown_verdict_is_refused(result):
    with pytest.raises(InputError, match="verdict 'both'"):
        replace(result, verdict="both").check()


def test_a_camera_without_a_focal_length_is_refused(result):
    with pytest.raises(InputError, match="intrinsics"):
        replace(result, intrinsics=np.zeros((3, 3))).check()


def test_a_lens_that_no_camera_has_is_refused(result):
    assert replace(result, distortion=np.array([-0.1, 0, 0, 0, 0])).check()
    with pytest.raises(InputError, match="folds the picture over"):
        replace(result, distortion=np.array([-9.0, 0, 0, 0, 0])).check()
