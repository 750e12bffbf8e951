"""The displacement of a mask, from one picture of it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci_calibration.probe import _shift

SIZE = (48, 64)
FINE = 20
ELEMENTS = np.random.default_rng(3).random(SIZE) < 0.25


def seen(right, down, sigma_px):
    """Return what pixels see of elements of their size, displaced by twentieths of a pixel, behind an optic's blur."""
    fine = np.kron(ELEMENTS.astype(float), np.ones((FINE, FINE)))
    fine = gaussian_filter(fine, sigma_px * FINE) if sigma_px else fine
    moved = np.roll(fine, (round(down * FINE), round(right * FINE)), (0, 1))
    return moved.reshape(SIZE[0], FINE, SIZE[1], FINE).mean(axis=(1, 3))


@pytest.mark.parametrize("sigma_px", [0.0, 0.5])
@pytest.mark.parametrize(("then", "now"), [((0, 0), (0.2, -0.15)), ((0.3, -0.2), (0.55, -0.2)), ((0.5, 0), (0.6, 0))])
def test_a_displacement_is_found_whatever_lay_between_pixels_before(then, now, sigma_px):
    mask, rng = seen(*then, sigma_px), np.random.default_rng(0)
    rest = (seen(*now, sigma_px) - mask).ravel() + 0.003 * rng.standard_normal(mask.size)
    found, errors = _shift(mask, np.ones(SIZE, bool), rest, np.full(mask.size, 1e-5))
    true = np.subtract(now, then)
    assert found == pytest.approx(true, abs=0.05)
    assert (np.abs(found - true) < 3 * np.array(errors)).all()


@pytest.mark.parametrize("mask", [np.ones(SIZE), np.tile(ELEMENTS[:1].astype(float), (SIZE[0], 1))])
def test_a_mask_without_structure_shows_no_displacement(mask):
    assert not np.isfinite(_shift(mask, np.ones(SIZE, bool), np.zeros(mask.size), np.full(mask.size, 1e-5))[1]).any()
