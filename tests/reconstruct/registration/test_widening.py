"""Open elements that are wider or narrower than stated are found where the measurement tells it."""

import numpy as np
import pytest

from gs2ci.reconstruct.registration.register import register
from gs2ci.reconstruct.registration.widening import MaskSum, expected, widened
from tests.reconstruct.registration.warps import blurred, regrown, warped


@pytest.mark.parametrize("px", [0.1, 0.35, 0.5, -0.1, -0.35, -0.5])
def test_a_wider_elements_share_of_a_pixel_is_its_area(bench, px):
    masks = bench.masks[:2, :24, :30].astype(float)
    assert widened(masks, px) == pytest.approx(regrown(masks, px), abs=1e-12)


def test_masks_stay_as_they_are_without_a_width(bench):
    masks = bench.masks.astype(float)
    assert widened(masks, 0.0) is masks
    for all_alike in (np.zeros_like(masks), np.ones_like(masks)):
        assert np.array_equal(widened(all_alike, 0.2), all_alike)
        assert np.array_equal(widened(all_alike, -0.2), all_alike)


@pytest.mark.parametrize("px", [0.0, 0.3, -0.3])
def test_the_sum_is_that_of_wider_masks(bench, px):
    weights = np.linspace(0.5, 1.5, len(bench.masks))
    part = (slice(10, 40), slice(8, 60))
    masks = bench.masks[:, part[0], part[1]]
    expected = np.tensordot(weights, widened(masks.astype(float), px), axes=1)
    assert MaskSum(bench.masks, weights, part).widened(px) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("px", [0.15, -0.15])
def test_a_width_is_found_with_the_shift_beside_it(bench, px):
    coarse = bench.masks[:, ::2, ::2].repeat(2, axis=1).repeat(2, axis=2)
    were = warped(regrown(coarse, px, 20), down_px=0.3, right_px=-0.2)
    found = register(bench.shoot(were=were, stated=coarse))
    assert found.misfit.widening_px == pytest.approx(px, abs=0.03)
    assert found.summary().widening_px == found.misfit.widening_px
    assert "beyond their stated edges" in found.notes[0].sentence
    assert [note.code for note in found.notes] == ["masks_corrected", "masks_as_drawn"]
    assert np.abs(found.shot.masks - were)[:, 3:-3, 3:-3].mean() < 0.02


def test_a_blur_is_not_taken_for_a_width(bench):
    for sigma_px in (0.5, 1.0):
        found = register(bench.shoot(were=blurred(bench.masks, sigma_px)))
        assert "widening_px" not in found.errors
        assert found.misfit.blur_sigma_px == pytest.approx(sigma_px, abs=0.05)


def test_soft_masks_are_not_asked(bench):
    soft = blurred(bench.masks, 0.6)
    found = register(bench.shoot(were=soft, stated=soft))
    assert not found.is_changed
    assert "widening_px" not in found.tried


@pytest.mark.parametrize("sigma", [0.05, 0.15])
def test_the_sum_expected_of_soft_masks_with_noise_is_nearer_to_the_true_one(bench, sigma):
    soft = blurred(bench.masks, 0.8)
    noise = np.random.default_rng(3).normal(0, sigma, soft.shape).sum(axis=0)
    true = soft.sum(axis=0)
    assert np.std(expected(true + noise) - true) < 0.8 * np.std(noise)
    assert np.abs(expected(true) - true).max() < 0.02


def test_a_sum_that_is_rough_itself_is_not_taken_for_noise(bench):
    total = bench.masks.sum(axis=0, dtype=np.float64)
    assert expected(total) is total
