from dataclasses import replace

import numpy as np
import pytest

from gs2ci_calibration.geometry.axes import StagePicture, SweepPicture, estimate_stage
from gs2ci_calibration.geometry.board import Board
from gs2ci_calibration.geometry.intrinsics import estimate_camera
from gs2ci_calibration.refusals import CalibrationError, Reason

BENCHES = 20
TARGETS = np.linspace(-30, 30, 7)


class Stage:
    """One axis of known truth before a known camera."""

    def __init__(self, camera, rng, **told):
        self.camera, self.rng = camera, rng
        way = np.array([1.0, 0.0, 0.0]) + rng.normal(0, 0.07, 3)
        self.scale = told.get("scale", rng.uniform(0.98, 1.02))
        self.per_mm = told.get("per_mm", self.scale * way / np.linalg.norm(way))
        self.backlash_mm = told.get("backlash_mm", rng.uniform(0, 0.2))
        self.repeatability_mm = told.get("repeatability_mm", rng.uniform(0, 0.02))
        self.speed_error = rng.uniform(-0.01, 0.01)
        self.slip_mm = told.get("slip_mm", 0.0)
        self.noise_px = told.get("noise_px", 0.01)
        self.rotation, self.start = camera.pose(rng, tilt_deg=8.0, fill=(0.5, 0.55))

    def see(self, along_mm):
        return self.camera.sight(self.rng, self.rotation, self.start - along_mm * self.per_mm, self.noise_px)

    def pictures(self, visits=2, targets=TARGETS, axis="x"):
        taken, slipped = [], 0.0
        for visit in range(2 * visits):
            upwards = visit % 2 == 0
            for target in targets if upwards else targets[::-1]:
                slipped += self.rng.uniform(0, self.slip_mm)
                at = target - slipped + (0 if not upwards else -self.backlash_mm)
                at += self.rng.normal(0, self.repeatability_mm)
                taken.append(StagePicture(axis, float(target), upwards, self.see(at)))
        return taken

    def sweep(self, axis="x", speed_mm_s=10.0):
        times = np.linspace(0, 5, 12)
        return [
            SweepPicture(axis, t, -25 + speed_mm_s * t, self.see(-25 + (1 + self.speed_error) * speed_mm_s * t))
            for t in times
        ]


@pytest.fixture
def known(camera):
    """A camera as estimated, and a stage before it."""
    rng = np.random.default_rng(5)
    return estimate_camera(camera.held(rng), camera.size), lambda **told: Stage(camera, rng, **told)


def refused(pictures, sweeps, camera, expected=None):
    with pytest.raises(CalibrationError) as caught:
        estimate_stage(pictures, sweeps, camera, expected)
    assert caught.value.step == "stage"
    return caught.value


def test_axes_are_within_their_limits_and_standard_errors_are_true_on_random_benches(cameras):
    inside, angles, scales = [], [], []
    for camera, rng in cameras(BENCHES):
        known = estimate_camera(camera.held(rng, noise_px=0.01), camera.size)
        stage = Stage(camera, rng)
        axis = estimate_stage(stage.pictures(), stage.sweep(), known)["x"]
        length = np.linalg.norm(stage.per_mm)
        cosine = np.clip(axis.direction @ stage.per_mm / length, -1, 1)
        angles.append(np.degrees(np.arccos(cosine)))
        scales.append(abs(axis.scale.value / length - 1))
        errors = [
            (axis.direction - stage.per_mm / length, axis.direction_errors),
            (axis.scale.value - length, axis.scale.standard_error),
            (axis.backlash_mm.value - stage.backlash_mm, axis.backlash_mm.standard_error),
            (axis.repeatability_mm.value - stage.repeatability_mm, axis.repeatability_mm.standard_error),
            (axis.speed_error.value - stage.speed_error, axis.speed_error.standard_error),
        ]
        inside.append(np.concatenate([np.ravel(np.abs(error) <= 2 * stated) for error, stated in errors]))
    assert max(angles) < 0.1
    assert max(scales) < 0.001
    # 95 % of 168 figures, three binomial deviations less.
    assert np.mean(inside) > 0.90


def test_without_noise_and_errors_the_axis_is_exact(known):
    camera, stage = known
    ideal = stage(backlash_mm=0.0, repeatability_mm=0.0, noise_px=0.0)
    found = estimate_stage(ideal.pictures(), ideal.sweep(), replace(camera, values=ideal.camera.values))["x"]
    assert found.per_mm == pytest.approx(ideal.per_mm, abs=1e-6)
    assert found.backlash_mm.value == pytest.approx(0, abs=1e-6)
    assert found.speed_error.value == pytest.approx(ideal.speed_error, abs=1e-6)
    assert found.direction_error_deg >= 0
    assert found.sweep_lag_s.value == pytest.approx(0, abs=1e-5)


def test_a_position_that_is_counted_late_is_known_to_its_standard_error(known):
    camera, stage = known
    late = stage(backlash_mm=0.0, repeatability_mm=0.0)
    sweep = [replace(picture, position_mm=picture.position_mm - 0.5) for picture in late.sweep()]
    lag = estimate_stage(late.pictures(), sweep, camera)["x"].sweep_lag_s
    assert abs(lag.value - 0.05) < 3 * lag.standard_error
    assert lag.standard_error < 0.002


def test_the_standard_error_of_a_scatter_is_that_of_as_many_returns(known):
    camera, stage = known
    found = estimate_stage(stage(repeatability_mm=0.02, noise_px=0.002).pictures(visits=3), [], camera)[
        "x"
    ].repeatability_mm
    # Of each of seven targets from two sides, three visits have two degrees of freedom.
    assert found.standard_error == pytest.approx(found.value / np.sqrt(2 * 28), rel=0.1)


def test_a_direction_and_its_errors_do_not_depend_on_how_far_the_axis_goes(known):
    camera, stage = known
    found = estimate_stage(stage().pictures(), [], camera)["x"]
    farther = replace(found, per_mm=2 * found.per_mm, covariance=4 * found.covariance)
    assert farther.direction_errors == pytest.approx(found.direction_errors)
    assert farther.direction_error_deg == pytest.approx(found.direction_error_deg)


def test_two_axes_are_told_apart(known):
    camera, stage = known
    first = stage(per_mm=np.array([1.0, 0.02, 0.0]))
    second = stage(per_mm=np.array([0.01, 0.99, 0.0]))
    second.rotation, second.start = first.rotation, first.start
    found = estimate_stage(first.pictures() + second.pictures(axis="y"), [], camera)
    assert list(found) == ["x", "y"]
    assert found["y"].direction[1] > 0.99
    assert found["x"].speed_error is None


def test_a_periodic_error_of_the_screw_shows_as_departure_from_the_line(known):
    camera, stage = known
    wavy = stage(repeatability_mm=0.0)
    pictures = [
        StagePicture("x", float(t), up, wavy.see(t + 0.02 * np.sin(2.4 * t)))
        for up in (True, False) * 2
        for t in TARGETS
    ]
    found = estimate_stage(pictures, [], camera)["x"]
    assert 0.005 < found.linearity_mm < 0.03
    assert found.repeatability_mm.value < 0.005


def test_a_stage_that_stands_still_is_refused(known):
    camera, stage = known
    error = refused(stage(per_mm=np.array([1e-5, 0, 0])).pictures(), [], camera)
    assert error.reason is Reason.STAGE_STILL


def test_a_stage_that_stands_still_is_refused_without_noise_too(known):
    camera, stage = known
    still = stage(per_mm=np.zeros(3), noise_px=0.0, repeatability_mm=0.0)
    assert refused(still.pictures(), [], camera).reason is Reason.STAGE_STILL


def test_a_slipping_stage_is_refused(known):
    camera, stage = known
    assert refused(stage(slip_mm=0.1).pictures(), [], camera).reason is Reason.STAGE_SLIPS


def test_an_axis_that_goes_another_distance_is_refused(known):
    camera, stage = known
    error = refused(stage(per_mm=np.array([0.25, 0, 0])).pictures(), [], camera)
    assert error.reason is Reason.STAGE_WRONG_WAY
    assert "0.25 times" in str(error)


@pytest.mark.parametrize(
    ("expected", "remedy"), [((-1.0, 0.0, 0.0), "reverse the sign"), ((0.0, 1.0, 0.0), "which axis is plugged in")]
)
def test_an_axis_that_goes_elsewhere_than_the_rig_file_says_is_refused(known, expected, remedy):
    camera, stage = known
    error = refused(stage().pictures(), [], camera, {"x": expected})
    assert error.reason is Reason.STAGE_WRONG_WAY
    assert remedy in str(error)


def test_a_mount_that_says_nothing_refuses_nothing(known):
    camera, stage = known
    assert "x" in estimate_stage(stage().pictures(), [], camera, {"x": (0.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)})


def test_a_picture_without_the_board_is_refused_by_its_number(known):
    camera, stage = known
    pictures = stage().pictures()
    pictures[3] = replace(pictures[3], sighting=None)
    error = refused(pictures, [], camera)
    assert error.reason is Reason.BOARD_NOT_SEEN
    assert "picture 4 of 28" in str(error)


def test_a_picture_with_one_line_of_corners_is_refused(known):
    camera, stage = known
    pictures = stage().pictures()
    seen, line = pictures[2].sighting, np.arange(6)
    assert np.ptp(Board().corners_mm[line, 1]) == 0
    alone = replace(seen, ids=line, corners_px=seen.corners_px[line], corners_mm=seen.corners_mm[line])
    pictures[2] = replace(pictures[2], sighting=alone)
    assert refused(pictures, [], camera).reason is Reason.DEGENERATE_VIEWS


def test_no_pictures_are_refused(known):
    camera, _ = known
    assert refused([], [], camera).reason is Reason.BOARD_NOT_SEEN


def test_too_few_targets_are_refused(known):
    camera, stage = known
    error = refused(stage().pictures(targets=TARGETS[:3]), [], camera)
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "3 positions" in str(error)


def test_targets_visited_once_are_refused(known):
    camera, stage = known
    assert refused(stage().pictures(visits=1), [], camera).reason is Reason.DEGENERATE_VIEWS


def test_a_sweep_that_goes_nowhere_says_nothing_of_the_speed(known):
    camera, stage = known
    mine = stage()
    sweep = [replace(picture, position_mm=0.0) for picture in mine.sweep()]
    assert estimate_stage(mine.pictures(), sweep, camera)["x"].speed_error is None
