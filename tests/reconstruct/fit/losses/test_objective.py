import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.losses.objective import DataTerm, LossWeights, add_regularisers

SIZE = (20, 27)
TENTH = LossWeights(similarity=0.1)


@pytest.fixture
def rng():
    return np.random.default_rng(5)


@pytest.fixture
def measurement(rng):
    return (3 * rng.random((*SIZE, 3))).astype(np.float32)


@pytest.fixture
def predicted(rng, measurement):
    return measurement + (0.3 * rng.standard_normal(measurement.shape)).astype(np.float32)


@pytest.fixture
def fitted(rng):
    return rng.random(SIZE) > 0.1


def stated(similarity, predicted, measurement, fitted, saturated, weight):
    """The objective as the paper and the class's docstring put it, in float64 under autograd."""
    image = torch.from_numpy(predicted).double().requires_grad_(True)
    seen = torch.from_numpy(fitted)[..., None]
    target = torch.from_numpy(measurement).double() * seen
    compared = image * seen
    if saturated is not None:
        compared = torch.where(torch.from_numpy(saturated)[..., None], torch.minimum(compared, target), compared)
    l1 = (compared - target).abs().sum() / (seen.sum() * measurement.shape[2])
    loss = (1 - weight) * l1 + weight * (1 - similarity(compared, target))
    loss.backward()
    return loss.item(), image.grad.numpy()


@pytest.mark.parametrize("weight", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("clipped", [False, True])
def test_value_and_gradient_follow_the_definition(
    similarity_definition, rng, measurement, predicted, fitted, weight, clipped
):
    saturated = rng.random(SIZE) < 0.2 if clipped else None
    value, gradient = stated(similarity_definition, predicted, measurement, fitted, saturated, weight)
    got, got_gradient = DataTerm(measurement, fitted, saturated, LossWeights(similarity=weight)).value_and_gradient(
        predicted
    )
    assert got == pytest.approx(value, rel=1e-5)
    assert np.linalg.norm(got_gradient - gradient) <= 1e-5 * np.linalg.norm(gradient)


@pytest.mark.parametrize("exposure", [0.05, 0.7, 3.0])
@pytest.mark.parametrize("clipped", [False, True])
def test_a_measurement_and_its_prediction_are_compared_in_units_of_the_exposure(
    rng, measurement, predicted, fitted, exposure, clipped
):
    saturated = rng.random(SIZE) < 0.2 if clipped else None
    value, gradient = DataTerm(measurement, fitted, saturated, TENTH).value_and_gradient(predicted)
    shown = np.float32(exposure)
    term = DataTerm(measurement * shown, fitted, saturated, TENTH, exposure)
    got, got_gradient = term.value_and_gradient(predicted * shown)
    assert got == pytest.approx(value, rel=1e-5)
    assert np.linalg.norm(exposure * got_gradient - gradient) <= 1e-4 * np.linalg.norm(gradient)
    alike = DataTerm(measurement, fitted, saturated, TENTH).dissimilarity(predicted)
    np.testing.assert_allclose(term.dissimilarity(predicted * shown), alike, atol=1e-4)


def test_one_channel_follows_the_definition(similarity_definition, measurement, predicted, fitted):
    parts = predicted[..., :1].copy(), measurement[..., :1].copy(), fitted, None, 0.1
    value, gradient = stated(similarity_definition, *parts)
    got, got_gradient = DataTerm(parts[1], fitted, None, TENTH).value_and_gradient(parts[0])
    assert got == pytest.approx(value, rel=1e-5)
    assert np.linalg.norm(got_gradient - gradient) <= 1e-5 * np.linalg.norm(gradient)


def test_held_out_pixels_have_exactly_no_gradient_and_no_influence(rng, measurement, predicted, fitted):
    elsewhere = ~fitted
    value, gradient = DataTerm(measurement, fitted, None, TENTH).value_and_gradient(predicted)
    assert elsewhere.any()
    assert (gradient[elsewhere] == 0).all()

    other_measurement, other_prediction = measurement.copy(), predicted.copy()
    other_measurement[elsewhere] = 100 * rng.random((elsewhere.sum(), 3))
    other_prediction[elsewhere] = -50
    again, same = DataTerm(other_measurement, fitted, None, TENTH).value_and_gradient(other_prediction)
    assert again == value
    np.testing.assert_array_equal(same, gradient)


def test_the_share_held_out_does_not_change_the_scale_of_the_l1_term(measurement):
    predicted = measurement + np.float32(0.25)
    for share in (0.0, 0.5):
        fitted = np.random.default_rng(0).random(SIZE) >= share
        value, _ = DataTerm(measurement, fitted, None, LossWeights(similarity=0.0)).value_and_gradient(predicted)
        assert value == pytest.approx(0.25, rel=1e-5)


def test_a_prediction_above_a_saturated_reading_is_no_error(measurement, fitted):
    saturated = np.ones(SIZE, bool)
    value, gradient = DataTerm(measurement, fitted, saturated, TENTH).value_and_gradient(measurement + np.float32(2))
    assert value == pytest.approx(0, abs=1e-7)
    np.testing.assert_allclose(gradient, 0, atol=1e-9)


def test_a_prediction_below_a_saturated_reading_is_one(measurement, fitted):
    saturated = np.ones(SIZE, bool)
    value, gradient = DataTerm(measurement, fitted, saturated, LossWeights(similarity=0.0)).value_and_gradient(
        measurement - np.float32(0.5)
    )
    assert value == pytest.approx(0.5, rel=1e-5)
    assert (gradient[fitted] < 0).all()


def test_a_saturation_map_without_saturated_pixels_changes_nothing(measurement, predicted, fitted):
    with_map = DataTerm(measurement, fitted, np.zeros(SIZE, bool), TENTH).value_and_gradient(predicted)
    without = DataTerm(measurement, fitted, None, TENTH).value_and_gradient(predicted)
    assert with_map[0] == without[0]
    np.testing.assert_array_equal(with_map[1], without[1])


def test_without_any_pixel_to_see_the_loss_and_its_gradient_are_zero(measurement, predicted):
    value, gradient = DataTerm(measurement, np.zeros(SIZE, bool), None, TENTH).value_and_gradient(predicted)
    assert value == pytest.approx(0, abs=1e-12)
    assert (gradient == 0).all()


def test_a_prediction_that_is_not_finite_gives_a_loss_that_is_not_finite(measurement, predicted, fitted):
    predicted[tuple(np.argwhere(fitted)[0])] = np.nan
    value, _ = DataTerm(measurement, fitted, None, TENTH).value_and_gradient(predicted)
    assert not np.isfinite(value)


@pytest.mark.parametrize("count", [1, 37])
def test_weights_ask_for_the_mean_opacity_and_the_mean_size_and_add_to_the_gradient(scattered, count):
    weights = LossWeights(opacity=0.3, size=0.7)
    scene = scattered(count)
    scene.opacity_logits[:3] = torch.tensor([-120.0, 0.0, 90.0])[:count]
    exact = scene.map(lambda tensor: tensor.double().requires_grad_())
    expected = 0.3 * torch.sigmoid(exact.opacity_logits).mean() + 0.7 * exact.log_scales.exp().mean()
    expected.backward()
    scene.log_scales.grad = torch.ones_like(scene.log_scales)
    assert add_regularisers(scene, weights) == pytest.approx(float(expected.detach()), rel=1e-6)
    torch.testing.assert_close(scene.opacity_logits.grad.double(), exact.opacity_logits.grad, rtol=1e-5, atol=1e-12)
    torch.testing.assert_close((scene.log_scales.grad - 1).double(), exact.log_scales.grad, rtol=1e-5, atol=3e-7)


def test_no_gaussians_ask_for_nothing(scattered):
    scene = scattered(3).map(lambda tensor: tensor[:0])
    assert add_regularisers(scene, LossWeights(size=0.1)) == 0


def test_the_dissimilarity_of_a_pixel_is_the_definitions_and_its_mean_that_of_the_loss(
    similarity_definition, measurement, predicted
):
    everything = np.ones(SIZE, bool)
    term = DataTerm(measurement, everything, None, LossWeights(similarity=1.0))
    error = term.dissimilarity(predicted)
    assert error.shape == SIZE
    assert error.dtype == np.float32
    value, _ = term.value_and_gradient(predicted)
    assert float(error.mean()) == pytest.approx(value, rel=1e-5)
    image, target = (torch.from_numpy(a).double() for a in (predicted, measurement))
    assert float(error.mean()) == pytest.approx(1 - float(similarity_definition(image, target)), rel=1e-5)
    assert np.abs(term.dissimilarity(measurement)).max() < 1e-6


def test_pixels_that_do_not_count_have_no_dissimilarity(rng, measurement, predicted, fitted):
    saturated = rng.random(SIZE) < 0.2
    error = DataTerm(measurement, fitted, saturated, TENTH).dissimilarity(predicted)
    assert not error[~fitted].any()
    assert not error[saturated & (predicted > measurement).all(axis=2)].any()
    assert error[fitted & ~saturated].any()


@pytest.mark.parametrize("window_px", [1, 10, -11, 257])
def test_a_window_without_a_middle_or_out_of_range_is_refused(window_px):
    with pytest.raises(InputError, match=f"window_px = {window_px} in LossWeights"):
        LossWeights(window_px=window_px).check()


def test_the_window_of_the_similarity_is_the_weights_own(measurement, rng):
    predicted = measurement + rng.normal(0, 0.1, measurement.shape).astype(np.float32)
    fitted = np.ones(SIZE, bool)
    values = [
        DataTerm(measurement, fitted, None, LossWeights(similarity=1.0, window_px=side)).value_and_gradient(predicted)[
            0
        ]
        for side in (3, 11)
    ]
    assert values[0] != values[1]
