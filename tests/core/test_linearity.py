"""The curve of readings over open masks, on scenes whose answer is known."""

import numpy as np
import pytest
from scipy import ndimage

from gs2ci.core.linearity import LARGEST_SIDE_PX, growth, lattices, middle


@pytest.fixture
def exposure():
    """Open masks and what a smooth scene reads behind them."""

    def make(n=6, size=(96, 120), ones=0.4, seed=0):
        rng = np.random.default_rng(seed)
        opened = (rng.random((n, *size)) < ones).sum(axis=0).astype(float)
        scene = 0.2 + ndimage.gaussian_filter(rng.random(size), 8) * 2
        return scene * opened, opened

    return make


@pytest.mark.parametrize("power", [1.0, 0.7, 0.5, 0.4545])
def test_light_is_a_straight_line_and_a_power_bends_it_as_it_should(exposure, power):
    image, opened = exposure(n=16, ones=0.5)
    found = growth(image**power, opened)
    assert found.slope == pytest.approx(power, abs=0.02)
    assert found.curvature == pytest.approx(0.5 * power * (power - 1), abs=0.03)


def test_a_leak_and_a_black_level_turn_the_line_but_do_not_bend_it(exposure):
    image, opened = exposure()
    scene = image / np.maximum(opened, 1)
    scene = np.where(opened > 0, scene, ndimage.uniform_filter(scene, 3))
    for seen in (image + 0.8 * ndimage.uniform_filter(scene, 5), image + 0.3):
        found = growth(seen, opened)
        assert found.slope < 0.95
        assert abs(found.curvature) < 4 * found.curvature_error + 0.01


def test_clipped_readings_are_left_out_and_where_they_are_everywhere_the_curve_says_so(exposure):
    image, opened = exposure()
    scene = np.linspace(0.2, 1, image.shape[1])[None] * np.ones(image.shape)
    image = scene * opened
    clip = float(np.quantile(image, 0.95))
    found = growth(np.minimum(image, clip), opened, clip=clip)
    assert not found.is_biased
    assert found.slope == pytest.approx(1, abs=0.03)
    heavily = float(np.quantile(opened, 0.85))
    assert growth(np.minimum(opened, heavily), opened, clip=heavily).is_biased


def test_dark_small_and_even_pictures_tell_nothing(exposure):
    image, opened = exposure()
    assert growth(image[:20, :20], opened[:20, :20]) is None
    assert growth(0 * image, opened) is None
    assert growth(image, np.ones_like(image)) is None
    assert growth(image, opened, clip=0.0) is None


def test_a_mosaic_is_asked_colour_by_colour(exposure):
    image, opened = exposure(size=(128, 160))
    colours = np.ones(image.shape)
    colours[::2, ::2], colours[1::2, 1::2] = 0.3, 0.6
    found = growth(image * colours, opened, is_mosaic=True)
    assert found.slope == pytest.approx(1, abs=0.01)
    assert found.unexplained < 0.2 * growth(image * colours, opened).unexplained


def test_the_middle_of_a_large_picture_begins_at_an_even_place():
    rows = np.arange(LARGEST_SIDE_PX + 102)[:, None] * np.ones((1, 4))
    cut = middle(rows)
    assert cut.shape == (LARGEST_SIDE_PX, 4)
    assert cut[0, 0] == 50
    assert [part.shape for part in lattices(np.zeros((3, 5, 7)), True)] == [(3, 3, 4), (3, 3, 3), (3, 2, 4), (3, 2, 3)]
