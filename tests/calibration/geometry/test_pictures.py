from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci_calibration.geometry.board import Board, Sighting
from gs2ci_calibration.geometry.pictures import BRIGHT_SHARE, Pictures, require_any, require_sharp
from gs2ci_calibration.refusals import CalibrationError, Reason

BLACK_DN = 64.0


class Lamp:
    """A bench of one formula: readings follow the light, the open mirrors and the exposure up to a full well."""

    exposure_limits_s = (1e-5, 10.0)
    top_dn = 4095

    def __init__(self, dn_per_s, well_dn=4095.0, stray_dn_per_s=0.0):
        self.dn_per_s, self.well_dn, self.stray_dn_per_s = dn_per_s, well_dn, stray_dn_per_s

    def flat_pattern(self, *, is_open):
        return np.full((4, 4), np.uint8(is_open))

    def grab(self, patterns, *, frames, exposure_s):
        shares = np.array([pattern.mean() for pattern in patterns])
        if self.dn_per_s < 0:
            shares = 1 - shares
        rate_dn_per_s = self.stray_dn_per_s + abs(self.dn_per_s) * shares
        light = np.minimum(BLACK_DN + rate_dn_per_s * exposure_s, self.well_dn)
        noise = np.random.default_rng(0).normal(0, 1, (len(patterns), frames, 20, 30))
        return SimpleNamespace(readings=(light[:, None, None, None] + noise).astype(np.float32))


def suited(lamp):
    return Pictures(lamp, "camera", Board()).suit_exposure()


def refused(lamp):
    with pytest.raises(CalibrationError) as caught:
        suited(lamp)
    return caught.value


@pytest.mark.parametrize("dn_per_s", [3e3, 1e5, 4e6])
def test_white_is_exposed_to_about_half_of_the_range_whatever_the_light(dn_per_s):
    share = dn_per_s * suited(Lamp(dn_per_s)) / (4095 - BLACK_DN)
    assert BRIGHT_SHARE[0] * 0.9 < share < BRIGHT_SHARE[1] * 1.1


def test_a_well_below_the_top_of_the_converter_is_not_filled():
    exposure_s = suited(Lamp(1e5, well_dn=2500.0))
    assert 1e5 * exposure_s < 2500 - BLACK_DN


def test_faint_light_is_taken_at_the_longest_exposure():
    assert suited(Lamp(200.0)) == 1.0


def test_no_light_is_refused():
    error = refused(Lamp(0.0))
    assert error.reason is Reason.NO_LIGHT
    assert "lens cap" in str(error)


def test_light_that_is_clipped_at_the_shortest_exposure_is_refused():
    assert refused(Lamp(1e9)).reason is Reason.SATURATED


@pytest.mark.parametrize("stray_dn_per_s", [3e3, 3e5, 3e6])
def test_stray_light_shortens_the_exposure_until_the_boards_white_has_room(stray_dn_per_s):
    exposure_s = suited(Lamp(1e5, stray_dn_per_s=stray_dn_per_s))
    assert BLACK_DN + (1e5 + stray_dn_per_s) * exposure_s < 4095
    assert 1e5 * exposure_s > 50


def test_stray_light_that_fills_the_sensor_at_any_exposure_is_refused():
    error = refused(Lamp(1e5, stray_dn_per_s=1e9))
    assert error.reason is Reason.SATURATED
    assert "with the modulator closed, pixels are 100% full" in str(error)


def test_a_modulator_that_darkens_when_it_opens_is_refused():
    assert refused(Lamp(-1e5)).reason is Reason.WRONG_POLARITY


def sighting(blur_px):
    corners = Board().corners_mm
    return Sighting(np.arange(24), corners[:, :2], corners, blur_px)


def test_sharp_pictures_pass_and_say_how_sharp_they_are():
    assert require_sharp("camera", [sighting(0.4), None, sighting(0.6)]) == pytest.approx(0.5)
    assert require_sharp("camera", [None]) == 0.0


def test_blurred_pictures_are_refused(cameras, photograph):
    (camera, _), *_ = cameras(1, (320, 420))
    blurred = Board().find(photograph(camera, blur_px=2.5)[0])
    with pytest.raises(CalibrationError) as caught:
        require_sharp("camera", [blurred, sighting(2.4), sighting(1.8)])
    assert caught.value.reason is Reason.BLURRED


def test_three_pictures_without_a_board_end_a_series_and_two_do_not():
    require_any("camera", [None, None])
    require_any("camera", [None, None, None, sighting(0.4)])
    with pytest.raises(CalibrationError) as caught:
        require_any("camera", [None, None, None])
    assert caught.value.reason is Reason.BOARD_NOT_SEEN
