from dataclasses import replace

import cv2
import numpy as np
import pytest

from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.geometry.intrinsics import estimate_camera
from gs2ci_calibration.refusals import CalibrationError, Reason

BENCHES = 24


def refused(sightings, size=(160, 200)):
    with pytest.raises(CalibrationError) as caught:
        estimate_camera(sightings, size)
    assert caught.value.step == "camera"
    return caught.value


def test_focal_length_is_within_its_limit_and_standard_errors_are_true_on_random_cameras(cameras):
    inside, focal = [], []
    for camera, rng in cameras(BENCHES):
        found = estimate_camera(camera.held(rng), camera.size)
        inside.append(np.abs(found.values - camera.values) <= 2 * found.standard_errors)
        focal.append(np.abs(found.values[:2] / camera.values[:2] - 1))
    assert np.max(focal) < 0.002
    # 95 % of 192 figures, three binomial deviations less.
    assert np.mean(inside) > 0.90
    assert np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12


def test_without_noise_the_camera_is_exact(camera):
    found = estimate_camera(camera.held(np.random.default_rng(1), noise_px=0.0), camera.size)
    assert found.values == pytest.approx(camera.values, abs=2e-3)
    assert found.matrix == pytest.approx(camera.matrix, abs=2e-3)
    assert np.isfinite(found.covariance).all()


def test_errors_that_all_corners_of_a_picture_share_widen_the_standard_errors(camera):
    rng = np.random.default_rng(2)
    sightings = camera.held(rng, noise_px=0.005)
    skewed = []
    for sighting in sightings:
        corners = sighting.corners_mm[:, :2] / 200.0
        bend = rng.normal(0, 0.05, 2)
        skewed.append(replace(sighting, corners_px=sighting.corners_px + bend * corners[:, :1] * corners[:, 1:]))
    even = estimate_camera(sightings, camera.size)
    assert (estimate_camera(skewed, camera.size).standard_errors[:4] > 1.5 * even.standard_errors[:4]).all()


def test_pictures_without_a_board_are_refused():
    assert refused([None] * 5).reason is Reason.BOARD_NOT_SEEN


def test_too_few_pictures_are_refused(camera):
    error = refused([*camera.held(np.random.default_rng(0), 5), None, None])
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "5 of 7 pictures" in str(error)


def test_collinear_corners_are_refused(camera):
    corners = Board().corners_mm
    line = np.arange(6)
    sightings = [
        Sighting(line, corners[line, :2] + shift, corners[line]) for shift in np.random.default_rng(0).normal(0, 9, 8)
    ]
    error = refused(sightings)
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "one line" in str(error)


def test_parallel_boards_are_refused(camera):
    error = refused(camera.held(np.random.default_rng(0), tilt_deg=1.0))
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "parallel" in str(error)


def test_corners_that_cover_little_of_the_frame_are_refused(camera):
    error = refused(camera.held(np.random.default_rng(0), fill=(0.1, 0.1), noise_px=0.0)[:1] * 8)
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "span" in str(error)


def test_corners_that_no_camera_explains_are_refused(camera):
    error = refused(camera.held(np.random.default_rng(0), noise_px=2.0))
    assert error.reason is Reason.BAD_FIT
    assert "px only" in str(error)


def test_one_picture_unlike_the_others_is_refused_by_its_number(camera):
    rng = np.random.default_rng(0)
    sightings = camera.held(rng)
    sightings[4] = replace(sightings[4], corners_px=sightings[4].corners_px + rng.normal(0, 0.4, (24, 2)))
    error = refused(sightings)
    assert error.reason is Reason.BAD_FIT
    assert "picture 5" in str(error)


def test_a_focal_length_that_stays_uncertain_is_refused(camera):
    error = refused(camera.held(np.random.default_rng(0), 6, tilt_deg=12.0, noise_px=0.3))
    assert error.reason is Reason.DEGENERATE_VIEWS
    assert "known to" in str(error)


def test_a_failure_inside_the_minimisation_is_a_refusal(camera, monkeypatch):
    def fail(*args, **kwargs):
        raise cv2.error("no")

    monkeypatch.setattr(cv2, "calibrateCamera", fail)
    assert refused(camera.held(np.random.default_rng(0))).reason is Reason.BAD_FIT


def test_figures_that_leave_the_finite_numbers_are_a_refusal(camera, monkeypatch):
    def wild(mm, px, size, *args, **kwargs):
        return 0.0, np.full((3, 3), np.nan), np.zeros(5), [np.zeros(3)] * len(mm), [np.ones(3)] * len(mm)

    monkeypatch.setattr(cv2, "calibrateCamera", wild)
    error = refused(camera.held(np.random.default_rng(0)))
    assert error.reason is Reason.BAD_FIT
    assert "diverged" in str(error)
