import pytest

from gs2ci_calibration.masks.planning import frames_wanted
from gs2ci_calibration.refusals import CalibrationError, Reason


def test_a_quarter_of_the_variance_takes_four_times_the_frames():
    assert frames_wanted(0.02, 2, 0.0, 0.01, "masks") == 8
    assert frames_wanted(0.02, 2, 0.0, 0.1, "masks") == 1


def test_what_frames_do_not_lower_is_left_out_of_the_reckoning():
    rms = (0.02**2 + 0.006**2) ** 0.5
    wanted = frames_wanted(rms, 2, 0.006, 0.01, "masks")
    assert wanted == 13  # 2 x 0.02^2 / (0.01^2 - 0.006^2), rounded up


@pytest.mark.parametrize(("fixed", "accuracy", "word"), [(0.02, 0.01, "dark frames"), (0.0, 1e-4, "1024")])
def test_what_cannot_be_reached_is_refused(fixed, accuracy, word):
    with pytest.raises(CalibrationError, match=word) as caught:
        frames_wanted(0.03, 2, fixed, accuracy, "masks")
    assert caught.value.reason is Reason.TOO_FEW_FRAMES
