"""What is asked of a source of geometry when the shot was taken through a lens."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.initialise import GeometrySettings, initialise
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.sources.sources import from_file, from_stage
from gs2ci.reconstruct.measurement.lens import Lens

QUICK = GeometrySettings(sweep=SweepSettings(planes=24))
DISTORTION = np.array([-0.2, 0, 0, 0, 0])
SIZE = (84, 112)
FOCAL_PX = 100.0


@pytest.fixture(scope="module")
def bent(seen, expose):
    """A scene of which every view is known on the canvas, and its measurement through a lens."""
    camera = np.array([[FOCAL_PX, 0, SIZE[1] / 2], [0, FOCAL_PX, SIZE[0] / 2], [0, 0, 1.0]])
    sensor = seen(size=SIZE)
    lens = Lens.of(expose(sensor, intrinsics=camera, distortion=DISTORTION))
    straight = seen(size=lens.sampling.canvas, focal=FOCAL_PX)
    np.testing.assert_allclose(straight.intrinsics, lens.canvas_intrinsics)
    views = lens.bent(straight.views)
    shot = expose(replace(sensor, views=views), intrinsics=camera, distortion=DISTORTION)
    return Request.of(shot, views, QUICK, lens), straight


def test_a_request_is_about_the_canvas(bent):
    request, straight = bent
    assert request.size == straight.views.shape[1:3] == request.seen.shape
    np.testing.assert_allclose(request.intrinsics, straight.intrinsics)
    seen = request.seen[None, ..., None]
    assert np.abs(np.where(seen, request.views - straight.views, 0)).mean() < 0.01


def test_without_a_lens_a_request_is_about_the_views_as_they_are(bent):
    shot = replace(bent[0].shot, distortion=None)
    request = Request.of(shot, bent[0].views, QUICK, None)
    assert request.views is bent[0].views
    assert request.intrinsics is shot.intrinsics
    assert request.seen is None


def test_path_and_depth_are_found_through_a_lens(bent, compare):
    request, straight = bent
    found = from_tracks(request, Silent())
    assert found.verdict == "full"
    assert found.focal_source == "file"
    assert found.inverse_depth.shape == request.size
    ideal = initialise(straight.views, straight.intrinsics, QUICK)
    for error in compare:
        assert error(found.world_to_camera, straight.poses) < 1.5 * error(ideal.world_to_camera, straight.poses) + 0.01
    assert unexplained(request.shot, request.views, found, request.lens) < 0.9 * unexplained(
        request.shot, request.views, replace(found, inverse_depth=np.ones_like(found.inverse_depth)), request.lens
    )


def test_stage_and_camera_files_are_taken_with_the_lens_that_the_shot_knows(bent, tmp_path, camera_file_of):
    request, straight = bent
    with_stage = replace(request, shot=replace(request.shot, telemetry_world_to_camera=straight.poses))
    assert from_stage(with_stage, Silent()).verdict == "full"
    for distortion in (DISTORTION, None):  # pictures as the sensor saw them, or undistorted ones
        file = camera_file_of(tmp_path, straight.poses, 1.3 * FOCAL_PX, SIZE, distortion)
        found = from_file(file, request, Silent())
        assert found.verdict == "full"
        np.testing.assert_array_equal(found.intrinsics, request.intrinsics)
        assert found.notes[0].code is Code.FOCAL_OF_SHOT
