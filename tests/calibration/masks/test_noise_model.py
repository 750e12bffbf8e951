import numpy as np
import pytest

from gs2ci_calibration.masks.noise_model import fit_noise, own_variance, rounding_variance_dn2
from gs2ci_calibration.refusals import CalibrationError, Reason


def samples(floor, slope, frames, pixels=20_000, seed=0):
    rng = np.random.default_rng(seed)
    signal = rng.uniform(0, 2000, pixels)
    variance = floor + slope * signal
    return signal, variance * rng.chisquare(frames - 1, pixels) / (frames - 1)


@pytest.mark.parametrize("frames", [2, 4, 32])
def test_the_line_is_found_from_few_frames(frames):
    model = fit_noise(*samples(4.0, 0.4, frames), "masks")
    assert model.slope_dn == pytest.approx(0.4, rel=0.05)
    assert model.variance(np.array([-5.0, 0.0, 1000.0]))[2] == pytest.approx(404.0, rel=0.03)
    assert model.variance(np.array([-5.0]))[0] == model.floor_dn2


def test_dark_pixels_whose_noise_rounding_hides_do_not_outweigh_the_rest():
    signal, variance = samples(0.0, 0.4, 2)
    dark = signal < 100
    model = fit_noise(np.where(dark, 0.0, signal), np.where(dark, 0.0, variance), "masks")
    assert model.variance(np.array([1000.0]))[0] == pytest.approx(400.0, rel=0.05)


def test_pixels_that_blink_keep_their_own_variance_and_do_not_spoil_the_line():
    signal, variance = samples(4.0, 0.4, 8)
    variance[:20] = 1e6
    model = fit_noise(signal, variance, "masks")
    assert model.slope_dn == pytest.approx(0.4, rel=0.05)
    own = own_variance(variance, model.variance(signal), 8)
    assert np.all(own[:20] == 1e6)
    assert own[100] == model.variance(signal)[100]
    assert np.array_equal(own_variance(variance, model.variance(signal), 2), model.variance(signal))


def test_frames_that_are_all_alike_are_refused():
    with pytest.raises(CalibrationError) as caught:
        fit_noise(np.full(100, 500.0), np.zeros(100), "masks")
    assert caught.value.reason is Reason.NO_VARIANCE


@pytest.mark.parametrize("noise_dn", [0.02, 0.3, 0.6])
def test_rounding_biases_a_mean_only_where_noise_is_below_a_step(noise_dn):
    rng = np.random.default_rng(0)
    true = rng.uniform(0, 1, 400)
    mean = np.rint(true[:, None] + rng.normal(0, noise_dn, (400, 4000))).mean(axis=1)
    bias = float(np.mean(np.square(mean - true)))
    stated = float(rounding_variance_dn2(np.array(noise_dn**2)))
    # The first term of its series: all of it but for no noise at all, where the sum is a twelfth.
    assert stated == pytest.approx(bias, rel=0.5, abs=2e-4)
