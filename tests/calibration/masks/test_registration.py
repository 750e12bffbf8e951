from typing import get_args

import numpy as np
import pytest

from gs2ci_calibration.masks import registration_fit
from gs2ci_calibration.masks.imaging import PixelMap, blurred, sharp
from gs2ci_calibration.masks.registration import orientation, register, require_orientation, require_ratio
from gs2ci_calibration.masks.texture import checker
from gs2ci_calibration.options import Orientation
from gs2ci_calibration.refusals import CalibrationError, Reason

SIZE, MODULATOR = (60, 72), (180, 200)
VALID = np.ones(SIZE, bool)
TRUTH = PixelMap(SIZE, np.array([[101.3, 88.6], [72.2, 0.3], [-0.4, 71.8]]))
START = PixelMap(SIZE, TRUTH.coefficients + np.array([[1.0, -0.8], [0.3, 0.0], [0.0, 0.4]]))
PATTERNS = [checker(MODULATOR, 6, np.random.default_rng(seed)) for seed in range(2)]


def seen(patterns, pixels, *, variance=0.3, noise=0.005, seed=0):
    rng = np.random.default_rng(seed)
    return [blurred(sharp(p, pixels)[0], variance) + rng.normal(0, noise, SIZE) for p in patterns]


def off_px(found, truth=TRUTH):
    (u, v), (a, b) = found.pixels.everywhere(), truth.everywhere()
    return float(np.sqrt(np.mean((u - a) ** 2 + (v - b) ** 2)) / 2)


def refusal(patterns, shares, valid=VALID, start=START):
    with pytest.raises(CalibrationError) as caught:
        register(patterns, shares, valid, start)
    return caught.value


def test_map_blur_and_their_errors_are_found_from_a_map_half_a_pixel_off():
    found = register(PATTERNS, seen(PATTERNS, TRUTH), VALID, START)
    assert off_px(found) < 0.003
    assert off_px(found) < 3 * found.rms_se_px
    assert found.pixels.degree == 1
    assert found.variance_px2 == pytest.approx(0.3, abs=4 * found.variance_se_px2)
    assert found.sigma_px == pytest.approx(np.sqrt(found.variance_px2))
    assert found.orientation == "upright"
    assert found.turn_mrad == pytest.approx(-4.9, abs=0.2)
    assert found.bend_px() == 0.0


def test_a_relay_without_blur_is_registered_too():
    found = register(PATTERNS, seen(PATTERNS, TRUTH, variance=0.0), VALID, START)
    assert off_px(found) < 0.003
    assert found.variance_px2 < 4 * found.variance_se_px2


def test_light_that_falls_off_draws_blurred_pixels_towards_it_and_is_reckoned_with():
    light = np.broadcast_to(np.linspace(0.3, 1.7, SIZE[1]), SIZE)
    shares = [
        blurred(sharp(pattern, TRUTH)[0] * light, 1.0) / blurred(light.copy(), 1.0)
        + np.random.default_rng(0).normal(0, 0.002, SIZE)
        for pattern in PATTERNS
    ]
    with_light, without = (register(PATTERNS, shares, VALID, START, light=one) for one in (light, None))
    assert off_px(with_light) < 0.003
    assert off_px(without) > 4 * off_px(with_light)


def test_a_bend_is_followed_and_an_affine_bench_is_not_bent():
    bent = TRUTH.raised(3)
    bent.coefficients[6] += [1.2, -0.8]
    found = register(PATTERNS, seen(PATTERNS, bent), VALID, START)
    assert found.pixels.degree == 3
    assert off_px(found, bent) < 0.01
    assert found.bend_px() > 0.05


def test_a_degree_can_be_demanded():
    found = register(PATTERNS, seen(PATTERNS, TRUTH), VALID, START, degree=3)
    assert found.pixels.degree == 3
    assert off_px(found) < 0.01


def test_dust_is_left_out():
    shares = seen(PATTERNS, TRUTH)
    for share in shares:
        share[14:24, 30:40] = 0.1
    found = register(PATTERNS, shares, VALID, START)
    assert found.dropped >= 1
    assert off_px(found) < 0.005


def test_another_pattern_is_refused():
    shares = seen([checker(MODULATOR, 6, np.random.default_rng(9)) for _ in PATTERNS], TRUTH)
    assert refusal(PATTERNS, shares).reason in {Reason.WRONG_ORDER, Reason.NOT_REGISTERED}


def test_an_inverted_pattern_is_refused():
    assert refusal(PATTERNS, [1 - share for share in seen(PATTERNS, TRUTH)]).reason in {
        Reason.WRONG_ORDER,
        Reason.NOT_REGISTERED,
    }


def test_a_pattern_without_texture_is_refused():
    plain = [np.ones(MODULATOR, np.uint8)]
    assert refusal(plain, [np.ones(SIZE)]).reason is Reason.NOT_REGISTERED


def test_tiles_on_one_line_are_refused():
    valid = np.zeros((24, 200), bool)
    valid[:12] = True
    start = PixelMap(valid.shape, np.array([[300.0, 50.0], [200.0, 0.0], [0.0, 200.0]]))
    patterns = [checker((120, 600), 6, np.random.default_rng(0))]
    share = blurred(sharp(patterns[0], start)[0], 0.3)
    found = refusal(patterns, [share], valid, start)
    assert found.reason is Reason.NOT_REGISTERED
    assert "one line" in str(found)


@pytest.mark.parametrize("columns", [2, 3])
def test_tiles_in_too_few_columns_hold_no_cubic_map_but_a_straight_one(columns):
    size = (200, 200)
    truth = PixelMap(size, np.array([[230.0, 230.0], [200.0, 0.3], [-0.4, 200.0]]))
    patterns = [checker((460, 460), 6, np.random.default_rng(seed)) for seed in range(2)]
    shares = [blurred(sharp(pattern, truth)[0], 0.3) for pattern in patterns]
    valid = np.zeros(size, bool)
    valid[:, : 20 * columns] = True  # tiles are 20 pixels wide
    with pytest.raises(CalibrationError, match="too few rows or columns") as caught:
        register(patterns, shares, valid, truth, degree=3)
    assert caught.value.reason is Reason.NOT_REGISTERED
    assert register(patterns, shares, valid, truth).pixels.degree == 1


@pytest.mark.parametrize("way", list(np.ndindex(2, 2, 2)))
def test_every_way_round_has_a_name_of_its_own_and_is_refused_unless_wanted(way):
    transpose, flip_x, flip_y = (bool(one) for one in way)
    turned = TRUTH.turned(transpose=transpose, flip_x=flip_x, flip_y=flip_y)
    name = orientation(turned)
    assert name in get_args(Orientation)
    assert (name == "upright") == (not any(way))
    for wanted in (name, "any"):
        require_orientation(turned, wanted)
    with pytest.raises(CalibrationError, match="by the rig file") as caught:
        require_orientation(turned, "mirrored top to bottom" if name == "upright" else "upright")
    assert caught.value.reason is Reason.FLIPPED


def test_an_image_turned_by_45_degrees_has_no_square_orientation():
    side = np.sqrt(0.5)
    turned = PixelMap(SIZE, np.array([[0.0, 0.0], [side, side], [-side, side]]))
    assert orientation(turned) == "turned by nearly 45 degrees"


def test_the_pixel_ratio_is_held_against_the_rig_file():
    require_ratio(TRUTH, 2)
    with pytest.raises(CalibrationError, match="by the rig file 3") as caught:
        require_ratio(TRUTH, 3)
    assert caught.value.reason is Reason.NOT_REGISTERED


def test_a_map_that_does_not_settle_is_refused(monkeypatch):
    monkeypatch.setattr(registration_fit, "ITERATIONS_MAX", 2)
    error = refusal(PATTERNS, seen(PATTERNS, TRUTH))
    assert error.reason is Reason.NOT_REGISTERED
    assert "after 2 steps it still moves by" in str(error)
