import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.metrics import SensorNoise, chi_squared_per_pixel


def test_the_right_prediction_leaves_one_per_pixel_whatever_the_light():
    rng = np.random.default_rng(0)
    truth = np.repeat(np.linspace(0, 4, 200, dtype=np.float32)[:, None, None], 200, axis=1)
    for noise in (SensorNoise(0.01), SensorNoise(0.005, 2000.0)):
        measured = truth + rng.standard_normal(truth.shape) * np.sqrt(noise.variance(truth))
        assert chi_squared_per_pixel(truth, measured.astype(np.float32), noise) == pytest.approx(1, abs=0.03)


def test_variance_is_read_noise_plus_shot_noise_and_negative_predictions_have_no_light():
    noise = SensorNoise(0.1, 50.0)
    np.testing.assert_allclose(noise.variance(np.array([0, 1, -3], np.float32)), [0.01, 0.03, 0.01])


def test_saturated_pixels_do_not_count():
    measured = np.zeros((2, 2, 3), np.float32)
    predicted = measured.copy()
    predicted[0, 0] = 5
    saturated = np.array([[True, False], [False, False]])
    assert chi_squared_per_pixel(predicted, measured, SensorNoise(0.1), saturated) == 0
    assert chi_squared_per_pixel(predicted, measured, SensorNoise(0.1), np.ones((2, 2), bool)) is None


@pytest.mark.parametrize("numbers", [(0.0,), (-0.1,), (np.nan,), (np.inf,), (0.1, 0.0), (0.1, np.nan)])
def test_a_noise_that_cannot_be_divided_by_is_refused(numbers):
    with pytest.raises(InputError):
        SensorNoise(*numbers)


def test_shapes_that_differ_are_refused():
    with pytest.raises(InputError, match="shape"):
        chi_squared_per_pixel(np.zeros((2, 2, 1), np.float32), np.zeros((2, 3, 1), np.float32), SensorNoise(0.1))
