import numpy as np
import pytest

from gs2ci_calibration.masks.gray_code import GrayCode, coarse_map
from gs2ci_calibration.masks.imaging import PixelMap, blurred, sharp
from gs2ci_calibration.refusals import CalibrationError, Reason

SIZE, MODULATOR = (40, 56), (150, 170)
VALID = np.ones(SIZE, bool)


def seen(code, pixels, variance=0.3):
    return np.stack([blurred(sharp(pattern, pixels)[0], variance) for pattern in code.patterns()])


@pytest.mark.parametrize("way", list(np.ndindex(2, 2, 2)))
@pytest.mark.parametrize("ratio", [1.0, 1.7, 2.5])
def test_the_map_is_found_whichever_way_round_the_image_lies(way, ratio):
    transpose, flip_x, flip_y = (bool(one) for one in way)
    code = GrayCode(MODULATOR, max(int(4 * ratio), 4))
    half = 28 * ratio
    upright = PixelMap(SIZE, np.array([[84.0, 75.0], [half, 0.02 * half], [-0.02 * half, half]]))
    truth = upright.turned(transpose=transpose, flip_x=flip_x, flip_y=flip_y)
    found = coarse_map(code, seen(code, truth), VALID)
    (u, v), (a, b) = truth.everywhere(), found.everywhere()
    assert np.hypot(u - a, v - b).max() / ratio < 1.5


def test_neighbouring_stripes_differ_in_one_pattern():
    patterns = GrayCode(MODULATOR, 4).patterns()
    rows, _ = GrayCode(MODULATOR, 4).bits
    changes = np.abs(np.diff(patterns[:rows, :, 0].astype(int), axis=1)).sum(axis=0)
    assert set(changes) == {0, 1}


def refusal(shares, code):
    with pytest.raises(CalibrationError) as caught:
        coarse_map(code, shares, VALID)
    assert caught.value.reason is Reason.NOT_REGISTERED
    return str(caught.value)


def test_stripes_that_cannot_be_read_are_refused():
    code = GrayCode(MODULATOR, 4)
    assert "can read the stripes" in refusal(np.full((len(code.patterns()), *SIZE), 0.5), code)


def test_readings_on_one_line_are_refused():
    code = GrayCode(MODULATOR, 4)
    shares = np.zeros((len(code.patterns()), *SIZE))
    assert "on one line" in refusal(shares, code)


def test_pixels_on_one_line_are_refused():
    code = GrayCode(MODULATOR, 4)
    shares = np.full((len(code.patterns()), *SIZE), 0.5)
    shares[:, 20:22] = seen(code, PixelMap(SIZE, np.array([[84.0, 75.0], [60.0, 0.0], [0.0, 60.0]])))[:, 20:22]
    assert "on one line" in refusal(shares, code)
