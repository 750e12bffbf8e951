"""Where the pattern of masks shows in a measurement, at any shift and in any orientation."""

import numpy as np
import pytest
from scipy import ndimage

from gs2ci.core.foreign.pattern import TURNS, trace


@pytest.fixture
def pattern():
    return (np.random.default_rng(0).random((6, 60, 60)) < 0.3).sum(axis=0).astype(float)


@pytest.fixture
def light():
    return 0.5 + 0.2 * np.sin(np.arange(60) / 9)[:, None] * np.cos(np.arange(60) / 7)[None, :]


def test_a_pattern_in_its_place_is_seen_there(pattern, light):
    found = trace(light * pattern, pattern)
    assert found.is_in_place
    assert found.can_be_mended
    assert found.correlation == pytest.approx(found.upright)
    assert found.upright > 0.9
    assert np.array_equal(found.moved(pattern), pattern)


@pytest.mark.parametrize("name", list(TURNS))
def test_every_orientation_is_told_from_the_others(pattern, light, name):
    found = trace(light * TURNS[name](pattern), pattern)
    assert found.turn == name
    assert np.array_equal(found.moved(pattern), TURNS[name](pattern))


def test_half_a_pixel_shows_beside_the_peak(pattern, light):
    found = trace(light * ndimage.shift(pattern, (0, 0.5), order=1, mode="nearest"), pattern)
    assert not found.is_in_place
    assert found.right_px == pytest.approx(0.5, abs=0.15)
    assert found.down_px == pytest.approx(0, abs=0.1)


def test_too_few_masks_are_not_to_be_mended(pattern, light):
    rest = (np.random.default_rng(1).random((20, 60, 60)) < 0.3).sum(axis=0)
    found = trace(light * (pattern + rest), pattern)
    assert found.is_in_place
    assert not found.can_be_mended


@pytest.mark.parametrize("image", [np.zeros((60, 60)), np.random.default_rng(2).normal(0, 1, (60, 60))])
def test_darkness_and_noise_show_nothing(pattern, image):
    found = trace(image, pattern)
    assert not found.shows
    assert not found.can_be_mended
    assert np.array_equal(found.moved(pattern), pattern)
