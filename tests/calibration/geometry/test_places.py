from dataclasses import replace

import cv2
import numpy as np
import pytest

from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.geometry.places import find_places
from gs2ci_calibration.refusals import CalibrationError, Reason


def shifted(camera, rng, noise_px=0.01, turn=0.0):
    rotation, start = camera.pose(rng, tilt_deg=8.0, fill=(0.5, 0.55))
    places = rng.uniform(-20, 20, (12, 3))
    sightings = [camera.sight(rng, rotation + turn * rng.normal(0, 1, 3), start - place, noise_px) for place in places]
    return places, sightings


def test_places_are_exact_without_noise(camera):
    places, sightings = shifted(camera, np.random.default_rng(0), noise_px=0.0)
    found = find_places(sightings, camera.values)
    assert np.allclose(np.diff(found.camera_mm, axis=0), np.diff(places, axis=0), atol=1e-6)
    assert found.residual_px < 1e-6


def test_the_covariance_of_a_place_is_true(cameras):
    z = []
    for camera, rng in cameras(12):
        places, sightings = shifted(camera, rng, noise_px=0.05)
        found = find_places(sightings, camera.values)
        errors = found.camera_mm - places
        errors -= errors.mean(axis=0)
        z.append(np.mean(np.square(errors), axis=0) / np.diag(found.covariance_mm2))
    # Each is a mean of 12 squares of about unit variance, less what the common rotation takes up.
    assert np.all(np.abs(np.mean(z, axis=0) - 1) < 0.35)


def test_a_stage_that_turns_the_camera_is_refused(camera):
    _, sightings = shifted(camera, np.random.default_rng(0), turn=0.05)
    with pytest.raises(CalibrationError, match="rotate the camera") as caught:
        find_places(sightings, camera.values)
    assert caught.value.reason is Reason.BAD_FIT


def test_a_picture_without_a_pose_is_refused(camera, monkeypatch):
    _, sightings = shifted(camera, np.random.default_rng(0))
    monkeypatch.setattr(cv2, "solvePnP", lambda *args, **kwargs: (False, np.zeros(3), np.zeros(3)))
    with pytest.raises(CalibrationError) as caught:
        find_places(sightings, camera.values)
    assert caught.value.reason is Reason.DEGENERATE_VIEWS


def test_a_start_from_before_is_refined(camera):
    _, sightings = shifted(camera, np.random.default_rng(0))
    first = find_places(sightings, camera.values)
    again = find_places(sightings, camera.values, start=replace(first, board_mm=first.board_mm + 0.5))
    assert np.allclose(again.board_mm, first.board_mm, atol=1e-6)


def test_six_corners_are_enough(camera):
    _, sightings = shifted(camera, np.random.default_rng(0), noise_px=0.0)
    few = [Sighting(s.ids[:8:1], s.corners_px[:8], s.corners_mm[:8]) for s in sightings]
    assert len(Board().corners_mm) == 24
    assert find_places(few, camera.values).residual_px < 1e-6
