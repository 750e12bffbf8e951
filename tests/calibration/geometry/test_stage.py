from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.geometry import stage as steps
from gs2ci_calibration.geometry.camera import section_of
from gs2ci_calibration.geometry.intrinsics import estimate_camera
from gs2ci_calibration.geometry.stage import measure_stage
from gs2ci_calibration.refusals import Reason
from gs2ci_drivers.axis import AxisInfo
from tests.benchmarks.calibration_geometry import stage_errors


class Counted(Silent):
    """Remembers how far the running stage is."""

    def stage(self, name, total=None):
        self.total, self.done = total, 0

    def step(self, done, **figures):
        self.done = done


@pytest.fixture
def with_camera(cameras, bench):
    """Make a bench, and a bundle with its camera as a careful calibration knows it."""

    def make(seed=0, **world):
        made, _, truth = bench(seed, **world)
        (seer, rng), *_ = cameras(1)
        fx, cx, cy = truth.intrinsics[0, 0], truth.intrinsics[0, 2], truth.intrinsics[1, 2]
        seer = replace(seer, values=np.array([fx, fx, cx, cy, *truth.distortion, 0.0, 0.0]))
        camera = estimate_camera(seer.held(rng, noise_px=0.01), seer.size)
        return made, truth, Bundle().with_section(section_of(camera))

    return make


def test_an_axis_of_a_bench_is_found_through_its_drivers(with_camera, monkeypatch):
    monkeypatch.setattr(steps, "TARGETS", 5)
    made, truth, known = with_camera(2)
    made = replace(made, progress=Counted())
    before_mm = made.devices.stage.connect() and made.devices.stage.positions_mm()
    section = measure_stage(made, known)
    errors = stage_errors(section, truth, "x")
    assert errors["direction_deg"][0] < 0.1
    assert abs(errors["scale"][0]) < 0.001
    assert all(abs(error) <= 3 * stated for error, stated in errors.values())
    assert made.devices.stage.positions_mm() == pytest.approx(before_mm, abs=1e-3)
    assert section.facts["pictures"] == 2 * steps.TARGETS * steps.VISITS + steps.SWEEP_PICTURES
    assert made.progress.done == made.progress.total == section.facts["pictures"]


def test_a_board_out_of_view_is_refused(with_camera, refusal):
    made, _, known = with_camera(always="flat")
    assert refusal(measure_stage, made, known).reason is Reason.BOARD_NOT_SEEN


def test_a_rig_without_a_stage_is_refused(bench, refusal):
    made, _, _ = bench(axes=())
    assert refusal(measure_stage, made, Bundle()).reason is Reason.NO_STAGE


def test_the_camera_is_needed_first(bench, refusal):
    made, _, _ = bench()
    error = refusal(measure_stage, made, Bundle())
    assert error.reason is Reason.NEEDS
    assert "gs2ci calibrate camera" in str(error)


def test_a_board_that_fills_the_frame_leaves_no_room(camera, refusal):
    rotation, translation = camera.pose(np.random.default_rng(0), tilt_deg=1.0, fill=(0.97, 0.98))
    known = estimate_camera(camera.held(np.random.default_rng(1)), camera.size)
    wide = camera.sight(np.random.default_rng(0), rotation, translation * np.array([1, 1, 0.7]))
    error = refusal(steps._room_to_move, wide, known)
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "rim" in str(error)


def test_an_axis_at_the_end_of_its_travel_has_no_room(refusal):
    axis = AxisInfo("x", 0.0, 20.0, 1e-4, 10.0, 1e-3, 100.0)
    error = refusal(steps._ends, axis, 0.0, steps._Room(0.5, 0.1))
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "middle of its travel" in str(error)
    assert steps._ends(axis, 10.0, steps._Room(4.0, 0.1)) == (6.0, 14.0)
