import numpy as np
import pytest

from gs2ci_calibration.frames import (
    Dark,
    check_lamp,
    check_stack,
    mean_and_variance,
    mean_error,
    root,
    rounding_bias_dn,
    rounding_variance_bias,
)
from gs2ci_calibration.refusals import CalibrationError, Reason


def test_a_stack_has_axes_numbers_and_life():
    rng = np.random.default_rng(0)
    alive = rng.normal(64, 1, (4, 5, 6)).astype(np.float32)
    check_stack("sensor", alive)
    for frames, reason in (
        (alive[0], Reason.TOO_FEW_FRAMES),
        (alive[:1], Reason.TOO_FEW_FRAMES),
        (np.full((4, 5, 6), np.inf, np.float32), Reason.DEAD_PIXELS),
        (np.full((4, 5, 6), 64, np.float32), Reason.NO_VARIANCE),
    ):
        with pytest.raises(CalibrationError) as error:
            check_stack("sensor", frames)
        assert error.value.reason is reason
        assert error.value.step == "sensor"


@pytest.mark.parametrize("frames", [2, 4, 16])
def test_means_of_few_frames_have_errors_as_large_as_stated(frames):
    stack = np.random.default_rng(1).normal(0, 2, (frames, 100, 100)).astype(np.float32)
    mean, variance = mean_and_variance(stack)
    # The prior leaves the highest percent out, which of so few frames carries a tenth of the variance.
    assert variance.mean() == pytest.approx(4, rel=0.12)
    assert variance.min() > 0
    within = np.mean(np.abs(mean) <= 2 * mean_error(variance, frames))
    assert 0.94 < within < 0.985


def test_rounding_biases_mean_and_variance_as_foretold():
    rng = np.random.default_rng(2)
    levels = np.linspace(0, 1, 40, endpoint=False)
    for noise in (0.2, 0.35):
        read = np.rint(levels[:, None] + noise * rng.standard_normal((40, 40_000)))
        bias = read.mean(axis=1) - levels
        assert np.sqrt(np.square(bias).mean()) == pytest.approx(rounding_bias_dn(noise), rel=0.05, abs=1e-3)
        for i in (0, 10, 20):
            # The bias of the mean squared is second order and left out of the bound.
            excess = read[i].var() - noise**2 - 1 / 12
            second = 2 * rounding_bias_dn(noise) ** 2
            assert abs(excess) <= rounding_variance_bias(noise, levels[i : i + 1]) + second + 2e-3
        assert rounding_variance_bias(noise, levels) < 1e-12


def test_the_root_of_a_variance_that_is_0_by_chance_has_an_error_of_its_scale():
    assert root(-0.1, 0.04) == (0.0, pytest.approx(0.2))
    assert root(4.0, 0.04) == (2.0, pytest.approx(0.01))


def test_a_lamp_is_judged_beyond_the_noise_of_the_pixels():
    rng = np.random.default_rng(3)
    dark = np.full((20, 30), 64.0)
    frames = 64 + rng.normal(500, 20, (32, 20, 30))
    lamp = check_lamp("masks", frames.astype(np.float32), dark)
    assert lamp.flicker < 0.002
    shaking = frames + 500 * 0.02 * rng.standard_normal((32, 1, 1))
    fading = 64 + (frames - 64) * np.linspace(1, 0.9, 32)[:, None, None]
    for wrong, reason in (
        (shaking, Reason.LAMP_FLICKERS),
        (fading, Reason.LAMP_DRIFTS),
        (frames - 600, Reason.NO_LIGHT),
    ):
        with pytest.raises(CalibrationError) as error:
            check_lamp("masks", wrong.astype(np.float32), dark)
        assert error.value.reason is reason


def test_dark_readings_grow_with_the_exposure():
    flags = np.zeros((2, 2), bool)
    dark = Dark(np.full((2, 2), 64.0), np.full((2, 2), 3.0), flags, ~flags)
    assert dark.at(2.0) == pytest.approx(70.0)
    assert not dark.good.any()
