"""Masks of open and closed elements are found from a blurred picture of them as long as it tells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from gs2ci.reconstruct.registration.misfit import variance_of
from gs2ci.reconstruct.registration.placement import Placement
from gs2ci.reconstruct.registration.sharpen import sources, unblur
from tests.reconstruct.registration.warps import blurred, warped


def binary_source(masks, place=None):
    """Find the masks before they were softened; None if there are none."""
    return next((one for one in sources(masks, place) if not one.how.startswith("with noise")), None)


def without_noise(masks):
    """Find the masks without their noise; None if they have none."""
    return next((one for one in sources(masks) if one.how.startswith("with noise")), None)


@pytest.fixture(scope="module")
def size(request):
    """Height and width of masks: larger ones by night."""
    return (64, 80) if request.config.option.nightly else (44, 56)


@pytest.fixture(scope="module")
def masks(size):
    return (np.random.default_rng(6).random((2, *size)) < 0.3).astype(float)


@pytest.mark.parametrize(("sigma_px", "noise"), [(0.5, 1e-2), (0.9, 1e-3), (1.4, 0.0), (2.0, 0.0)])
def test_a_blur_that_leaves_half_of_the_frequencies_is_undone(masks, sigma_px, noise):
    soft = blurred(masks, sigma_px) + np.random.default_rng(7).normal(0, 1, masks.shape) * noise
    found = binary_source(np.clip(soft, 0, 1).astype(np.float32))
    assert np.abs(found.masks - masks).max() < max(2 * noise, 1e-4)
    assert found.how.startswith("blurred by σ")
    assert found.placement.is_identity


@pytest.mark.parametrize(("sigma_px", "noise"), [(0.4, 1e-2), (0.6, 1e-2), (0.9, 1e-3)])
@pytest.mark.parametrize("corner", [1.0, 0.7, 0.45])
def test_what_open_and_closed_elements_pass_is_kept(masks, corner, sigma_px, noise):
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in masks.shape[1:]), indexing="ij")
    vignetting = 1 - (1 - corner) * (x**2 + y**2) / 2
    soft = 0.03 + 0.9 * vignetting * blurred(masks, sigma_px)
    noisy = np.clip(soft + np.random.default_rng(7).normal(0, 1, masks.shape) * noise, 0, 1)
    found = binary_source(noisy.astype(np.float32))
    true = 0.03 + 0.9 * vignetting * masks
    assert abs(found.masks.mean() - noisy.mean()) < 1e-3
    assert np.mean(np.abs(found.masks - true) > 0.03) < 1e-3
    assert found.blur_px2 == pytest.approx(variance_of(sigma_px), rel=0.05)


@pytest.mark.parametrize("sigma_px", [0.0, 0.3, 0.5])
def test_a_picture_that_was_blurred_before_it_was_interpolated_keeps_its_levels(masks, sigma_px):
    """Without that blur, closed elements would seem to pass more, and open ones less."""
    down, right, true = 0.2, -0.35, 0.02 + 0.9 * masks
    soft = 0.02 + 0.9 * (blurred(masks, sigma_px) if sigma_px else masks)
    around = np.pad(soft, ((0, 0), (1, 1), (1, 1)), mode="edge")
    soft = (1 - down) * around[:, 1:-1] + down * around[:, :-2]
    soft = (1 + right) * soft[..., 1:-1] - right * soft[..., 2:]
    noisy = soft + np.random.default_rng(7).normal(0, 5e-3, masks.shape)
    found = binary_source(np.clip(noisy, 0, 1).astype(np.float32), Placement().moved(-0.1, 0.3))
    assert found.placement.shift_px == pytest.approx((-down, -right), abs=0.03)
    assert np.mean(np.abs(found.masks - true) > 0.02) < 1e-3
    between = np.mean([0.2 * 0.8, 0.35 * 0.65])
    assert found.blur_px2 == pytest.approx(between + (variance_of(sigma_px) if sigma_px else 0), abs=0.02)


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_a_first_mask_that_is_wholly_closed_or_open_does_not_hide_how_soft_the_others_are(masks, light):
    with_first = np.concatenate([np.full_like(masks[:1], light), masks])
    found = binary_source(np.clip(blurred(with_first, 0.9), 0, 1).astype(np.float32))
    assert found is not None
    assert np.abs(found.masks - with_first).max() < 1e-3
    assert found.blur_px2 == pytest.approx(variance_of(0.9), rel=0.05)


def test_a_blur_that_leaves_less_is_not_guessed_at(masks):
    soft = blurred(masks, 2.0) + np.random.default_rng(7).normal(0, 1e-3, masks.shape)
    assert binary_source(np.clip(soft, 0, 1).astype(np.float32)) is None


def test_masks_that_never_were_open_or_closed_have_no_source(masks):
    grey = np.random.default_rng(8).random(masks.shape)
    assert binary_source(blurred(grey, 0.8).astype(np.float32)) is None
    assert binary_source(masks.astype(np.float32)) is None


@pytest.mark.parametrize("sigma", [0.01, 0.05, 0.1])
@pytest.mark.parametrize(("closed", "open_"), [(0.0, 1.0), (0.04, 0.9)])
def test_noise_of_a_calibration_is_taken_out_of_open_and_closed_elements(masks, closed, open_, sigma):
    true = closed + (open_ - closed) * masks
    noisy = np.clip(true + np.random.default_rng(7).normal(0, sigma, masks.shape), 0, 1)
    (found,) = sources(noisy.astype(np.float32))
    assert found.how.startswith("with noise of σ")
    assert found.blur_px2 == 0
    assert np.sqrt(np.mean((found.masks - true) ** 2)) < 0.35 * np.sqrt(np.mean((noisy - true) ** 2))


def test_elements_between_open_and_closed_are_as_open_as_is_probable(masks):
    noisy = np.clip(masks + np.random.default_rng(7).normal(0, 0.25, masks.shape), 0, 1)
    found = without_noise(noisy.astype(np.float32)).masks
    rounded = (noisy > 0.5).astype(float)
    assert np.mean((found - masks) ** 2) < 0.75 * np.mean((rounded - masks) ** 2)
    assert np.mean((found - masks) ** 2) < 0.6 * np.mean((noisy - masks) ** 2)


@pytest.mark.parametrize(
    "was", [{"scale": 1.02}, {"scale": 0.98}, {"turn_deg": 0.4}, {"down_px": 0.4, "right_px": -0.4}]
)
def test_masks_resampled_at_another_scale_or_turned_are_put_back_element_by_element(masks, was):
    """The place is right to a third of a pixel in the corners, as measurements give it for soft masks."""
    shift = np.array([was.get(name, 0.0) for name in ("down_px", "right_px")])
    true = Placement(*shift, rotation_deg=was.get("turn_deg", 0.0), scale=was.get("scale", 1.0) - 1)
    back = np.linalg.inv(true.matrix)
    near = Placement.from_affine(back, [0.15, -0.1] - back @ shift)
    found = binary_source(warped(masks, **was).astype(np.float32), replace(near, scale=near.scale + 0.004))
    assert found.placement.matrix == pytest.approx(back, abs=5e-4)
    assert found.placement.shift_px == pytest.approx(-back @ shift, abs=0.01)
    told = ~binary_dilation(found.unknown, iterations=2, border_value=1)
    assert np.mean(np.abs(found.masks - masks)[:, told] > 0.05) < 1e-3


def test_exact_masks_and_grey_ones_have_no_noise(masks):
    grey = np.random.default_rng(8).random(masks.shape)
    for exact in (masks, 0.1 + 0.8 * masks, np.rint(255 * (0.1 + 0.8 * masks)) / 255, grey, blurred(masks, 0.8)):
        assert without_noise(exact.astype(np.float32)) is None


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_masks_that_are_the_same_everywhere_have_no_source(level):
    assert sources(np.full((3, 32, 32), level, np.float32)) == []


def test_steps_find_what_filtering_leaves_out(masks):
    soft = blurred(masks, 2.0)
    filtered, stepped = (unblur(soft, 2.0, 1e-6, steps) for steps in (0, 100))
    assert np.mean((filtered > 0.5) != masks) > 0.01
    assert np.abs(stepped - masks).max() < 0.3


def test_softness_that_explains_too_little_and_pictures_that_are_too_small_tell_no_source(masks):
    """Noise of a fourteenth of their variance; and twelve rows, which hold too few elements."""
    soft = blurred(masks[:1, :40, :48], 0.6)
    noisy = soft + np.random.default_rng(7).normal(0, np.sqrt(0.075 * soft.var()), soft.shape)
    assert binary_source(noisy.astype(np.float32)) is None
    assert sources(np.clip(soft, 0, 1)[:, :12].astype(np.float32)) == []
