import numpy as np
import pytest

from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.masks.imaging import PixelMap, convolved, sharp
from gs2ci_calibration.masks.predicted import (
    Relay,
    fit_kernel,
    model_error,
    relay_of,
    transmissions,
)
from gs2ci_calibration.masks.texture import checker
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.calibration.masks.relays import gaussian_relay

SIZE, MODULATOR = (40, 48), (100, 110)
PIXELS = PixelMap(SIZE, np.array([[55.2, 50.7], [48.0, 0.3], [-0.3, 48.0]]))
VALID = np.ones(SIZE, bool)
PATTERNS = [checker(MODULATOR, 2, np.random.default_rng(seed)) for seed in range(3)]


def lopsided():
    taps = np.zeros((5, 5))
    taps[2, 1:4] = [0.2, 0.6, 0.1]
    taps[1, 2] = 0.1
    return taps


def test_a_kernel_that_is_no_gaussian_is_found_with_its_errors():
    rng = np.random.default_rng(0)
    shares = [convolved(sharp(p, PIXELS)[0], lopsided()) + rng.normal(0, 0.01, SIZE) for p in PATTERNS]
    kernel = fit_kernel(PIXELS, 0.1, PATTERNS, shares, VALID)
    assert kernel.taps.sum() == pytest.approx(1.0)
    assert np.mean(np.abs(kernel.taps - lopsided()) <= 2 * kernel.standard_error) > 0.85
    assert kernel.residual_rms == pytest.approx(0.01, rel=0.1)


def test_patterns_without_detail_do_not_tell_a_kernel():
    plain = [np.ones(MODULATOR, np.uint8)]
    with pytest.raises(CalibrationError) as caught:
        fit_kernel(PIXELS, 0.3, plain, [np.ones(SIZE)], VALID)
    assert caught.value.reason is Reason.NOT_REGISTERED


def test_many_pixels_are_thinned_and_tell_the_same(monkeypatch):
    shares = [convolved(sharp(p, PIXELS)[0], lopsided()) for p in PATTERNS]
    monkeypatch.setattr("gs2ci_calibration.masks.predicted.PIXELS_USED", 1500)
    assert fit_kernel(PIXELS, 0.1, PATTERNS, shares, VALID).taps == pytest.approx(lopsided(), abs=1e-6)


def test_a_turned_relay_turns_its_blur_as_well():
    relay = Relay(PixelMap((40, 40), PIXELS.coefficients), lopsided())
    plain = relay.shares(np.stack(PATTERNS))
    for flip_x, flip_y in np.ndindex(2, 2):
        turned = relay.turned(transpose=False, flip_x=bool(flip_x), flip_y=bool(flip_y))
        expected = plain[:, :: -1 if flip_y else 1, :: -1 if flip_x else 1]
        assert turned.shares(np.stack(PATTERNS)) == pytest.approx(expected, abs=1e-5)
    transposed = relay.turned(transpose=True, flip_x=False, flip_y=False)
    assert transposed.shares(np.stack(PATTERNS)) == pytest.approx(plain.transpose(0, 2, 1), abs=1e-5)


def test_an_open_modulator_looks_open_and_levels_count_from_their_top():
    relay = gaussian_relay(PIXELS, 0.4)
    grey = np.full((1, *MODULATOR), 3, np.uint8)
    assert relay.shares(grey, top=3) == pytest.approx(np.ones((1, *SIZE)), abs=1e-5)
    assert transmissions(np.array([0.0, 1.0]), np.array([0.1, 0.1])) == pytest.approx([0.1, 1.0])


def registration(size):
    estimates = {
        "modulator_from_sensor": Estimate(PIXELS.coefficients, 0.01, "px"),
        "psf_kernel": Estimate(lopsided(), 0.01, "1"),
    }
    return Section("registration", estimates, facts={"size": list(size)})


def test_a_registration_of_another_sensor_size_does_not_fit():
    assert np.array_equal(relay_of(registration(SIZE), SIZE, "masks").taps, lopsided())
    with pytest.raises(CalibrationError) as caught:
        relay_of(registration((8, 8)), SIZE, "masks")
    assert caught.value.reason is Reason.DOES_NOT_FIT


def test_the_models_error_is_what_noise_does_not_explain():
    rng = np.random.default_rng(0)
    foreseen = rng.random(50_000)
    seen = foreseen + rng.normal(0, 0.02, 50_000) + rng.normal(0, 0.01, 50_000)
    rms, error = model_error(seen, np.full(50_000, 0.02**2), foreseen)
    assert abs(rms - 0.01) < 4 * error
    assert error < 1e-3
    assert model_error(foreseen, np.zeros(50_000), foreseen) == (0.0, 0.0)
