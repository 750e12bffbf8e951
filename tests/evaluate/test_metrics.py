import numpy as np
import pytest
from skimage.metrics import structural_similarity

from gs2ci.core.errors import InputError
from gs2ci.evaluate.metrics import measurement_residual, psnr_per_view, ssim_per_view


def stack(value, shape=(2, 16, 20, 3)):
    return np.full(shape, value, np.float32)


def test_psnr_of_a_constant_error_is_its_decibels():
    assert psnr_per_view(stack(0.5), stack(0.6)) == pytest.approx([20.0, 20.0], abs=1e-4)


def test_psnr_is_taken_view_by_view():
    estimate = stack(0.5)
    estimate[1] = 0.51
    assert psnr_per_view(estimate, stack(0.5)) == pytest.approx([100.0, 40.0], abs=1e-3)


def test_psnr_clamps_both_stacks():
    assert psnr_per_view(stack(7.0), stack(1.3)) == [100.0, 100.0]


def test_psnr_of_identical_views_stays_finite():
    assert psnr_per_view(stack(0.25), stack(0.25)) == [100.0, 100.0]


def test_ssim_follows_scikit_image_with_gaussian_weights():
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 1, 24, 31, 3)).astype(np.float32)
    wanted = structural_similarity(
        a[0].astype(float), b[0].astype(float), gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        data_range=1.0, channel_axis=-1,
    )  # fmt: skip
    assert ssim_per_view(a, b) == pytest.approx([wanted], abs=1e-12)


def test_ssim_follows_wangs_formula_written_out():
    """Constant images have no variance: SSIM is its luminance term (2ab + c1) / (a² + b² + c1)."""
    c1 = 0.01**2
    wanted = (2 * 0.5 * 0.6 + c1) / (0.5**2 + 0.6**2 + c1)
    assert ssim_per_view(stack(0.5), stack(0.6)) == pytest.approx([wanted] * 2, rel=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(1, 1), (5, 40), (10, 11), (11, 11), (16, 16)])
def test_ssim_is_defined_for_images_smaller_than_its_window(size, channels):
    rng = np.random.default_rng(1)
    a, b = rng.random((2, 2, *size, channels)).astype(np.float32)
    assert ssim_per_view(a, a) == pytest.approx([1.0, 1.0])
    assert all(-1 <= value < 1 for value in ssim_per_view(a, b))


@pytest.mark.parametrize("measure", [psnr_per_view, ssim_per_view])
@pytest.mark.parametrize("shape", [(2, 16, 21, 3), (1, 16, 20, 3), (16, 20, 3)])
def test_views_of_another_shape_are_refused(measure, shape):
    with pytest.raises(InputError, match="cannot be compared"):
        measure(stack(0.0, shape), stack(0.0))


@pytest.mark.parametrize("measure", [psnr_per_view, ssim_per_view])
def test_no_views_at_all_are_refused(measure):
    empty = stack(0.0, (0, 16, 20, 3))
    with pytest.raises(InputError, match="cannot be compared"):
        measure(empty, empty)


def test_residual_is_rms_and_mean_absolute_value():
    measured = np.zeros((2, 1, 1), np.float32)
    predicted = np.array([[[3.0]], [[-1.0]]], np.float32)
    residual = measurement_residual(predicted, measured)
    assert residual.rms == pytest.approx(np.sqrt(5))
    assert residual.mean_abs == pytest.approx(2.0)


def test_residual_counts_predictions_above_a_saturated_reading_as_exact():
    measured = np.ones((1, 3, 1), np.float32)
    predicted = np.array([[[1.5], [0.5], [1.5]]], np.float32)
    saturated = np.array([[True, True, False]])
    assert measurement_residual(predicted, measured, saturated).mean_abs == pytest.approx((0 + 0.5 + 0.5) / 3)


def test_residual_of_another_shape_is_refused():
    with pytest.raises(InputError, match="predicted measurement"):
        measurement_residual(np.zeros((2, 2, 3), np.float32), np.zeros((2, 2, 1), np.float32))
