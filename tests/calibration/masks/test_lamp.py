import numpy as np
import pytest

from gs2ci_calibration.masks.lamp import LampRecord, burst_levels
from gs2ci_calibration.refusals import CalibrationError, Reason


def record(level, per_burst=5):
    level = np.asarray(level, dtype=np.float64)
    return LampRecord(np.arange(len(level)) * 0.1, level, np.arange(len(level)) // per_burst)


def refusal(lamp, frames=8, accuracy=0.01):
    with pytest.raises(CalibrationError) as caught:
        lamp.require_steady(frames, accuracy)
    return caught.value.reason


def test_a_lamp_that_drifts_steadily_does_not_flicker():
    lamp = record(1 + 0.1 * np.linspace(0, 1, 50))
    assert lamp.flicker < 1e-4
    assert lamp.drift == pytest.approx(0.1, rel=0.1)
    lamp.require_steady(8, 0.01)


def test_flicker_is_the_rms_of_one_frames_light():
    lamp = record(1 + np.random.default_rng(0).normal(0, 0.01, 4000))
    assert lamp.flicker == pytest.approx(0.01, rel=0.05)


def test_flicker_is_refused_unless_enough_frames_average_it():
    lamp = record(1 + np.random.default_rng(0).normal(0, 0.03, 50))
    assert refusal(lamp) is Reason.LAMP_FLICKERS
    lamp.require_steady(128, 0.01)


def test_a_drift_beyond_what_references_follow_is_refused():
    assert refusal(record(np.linspace(1, 1.5, 50))) is Reason.LAMP_DRIFTS


@pytest.mark.parametrize("level", [[], [1.0], [1.0, 1.01]])
def test_few_references_tell_nothing_of_flicker(level):
    assert record(level).flicker == 0.0
    assert np.isfinite(record(level).drift)


def test_references_at_the_same_time_are_passed_over():
    lamp = LampRecord(np.zeros(5), np.array([1.0, 1.1, 0.9, 1.0, 1.2]), np.zeros(5, np.int64))
    assert lamp.flicker == 0.0


def test_the_level_is_the_light_over_that_of_the_references():
    swing = np.array([100.0, 300.0])
    assert burst_levels(np.array([[50.0, 150.0], [110.0, 330.0]]), swing) == pytest.approx([0.5, 1.1])
