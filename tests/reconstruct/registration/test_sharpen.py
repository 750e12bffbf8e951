"""Masks of open and closed elements are found from a blurred picture of them as long as it tells."""

import numpy as np
import pytest

from gs2ci.reconstruct.registration.sharpen import binary_source, unblur
from tests.reconstruct.registration.warps import blurred


@pytest.fixture(scope="module")
def masks():
    return (np.random.default_rng(6).random((2, 64, 80)) < 0.3).astype(float)


@pytest.mark.parametrize(("sigma_px", "noise"), [(0.5, 1e-2), (0.9, 1e-3), (1.4, 0.0), (2.0, 0.0)])
def test_a_blur_that_leaves_half_of_the_frequencies_is_undone(masks, sigma_px, noise):
    soft = blurred(masks, sigma_px) + np.random.default_rng(7).normal(0, 1, masks.shape) * noise
    found = binary_source(np.clip(soft, 0, 1).astype(np.float32))
    assert np.array_equal(found.masks, masks)
    assert found.how.startswith("blurred by σ")
    assert found.shift_px == (0.0, 0.0)


def test_a_blur_that_leaves_less_is_not_guessed_at(masks):
    soft = blurred(masks, 2.0) + np.random.default_rng(7).normal(0, 1e-3, masks.shape)
    assert binary_source(np.clip(soft, 0, 1).astype(np.float32)) is None


def test_masks_that_never_were_open_or_closed_have_no_source(masks):
    grey = np.random.default_rng(8).random(masks.shape)
    assert binary_source(blurred(grey, 0.8).astype(np.float32)) is None
    assert binary_source(masks.astype(np.float32)) is None


def test_steps_find_what_filtering_leaves_out(masks):
    soft = blurred(masks, 2.0)
    filtered, stepped = (unblur(soft, 2.0, 1e-6, steps) for steps in (0, 100))
    assert np.mean((filtered > 0.5) != masks) > 0.01
    assert np.abs(stepped - masks).max() < 0.3
