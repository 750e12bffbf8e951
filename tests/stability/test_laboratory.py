import numpy as np
import pytest

from gs2ci_sims.masks import random_masks
from tests.stability.laboratory import laboratory_masks


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def laboratory():
    return laboratory_masks(2, (330, 330), 0.5, rng())


def test_masks_of_a_laboratory_leak_as_measured_ones_do(laboratory):
    off = laboratory[laboratory < 0.1]
    assert np.median(off) == pytest.approx(0.041, abs=0.006)
    assert np.quantile(off, 0.1) == pytest.approx(0.017, abs=0.006)
    assert np.quantile(off, 0.9) == pytest.approx(0.083, abs=0.012)


def test_masks_of_a_laboratory_have_as_many_grey_and_as_many_clipped_pixels_as_measured_ones(laboratory):
    assert 0.34 <= np.mean((laboratory > 0.1) & (laboratory < 0.9)) <= 0.42
    assert 0.26 <= np.mean(laboratory == 1.0) <= 0.33


@pytest.mark.parametrize(("lag", "low", "high"), [(1, 0.59, 0.67), (2, 0.09, 0.20), (3, 0.0, 0.03)])
def test_masks_of_a_laboratory_correlate_over_as_many_pixels_as_measured_ones(laboratory, lag, low, high):
    centred = laboratory - laboratory.mean()
    down, right = (centred[:, lag:] * centred[:, :-lag]).mean(), (centred[:, :, lag:] * centred[:, :, :-lag]).mean()
    assert low <= 0.5 * (down + right) / centred.var() <= high


def test_masks_of_a_laboratory_are_those_that_were_shown(laboratory):
    shown = random_masks(2, (330, 330), 0.5, rng(), feature_px=2)
    assert np.corrcoef(laboratory.ravel(), shown.ravel())[0, 1] > 0.9
