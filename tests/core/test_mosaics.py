"""Where the greens of a mosaic stand."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.mosaics import GREENS_FALL, GREENS_RISE, greens_of
from gs2ci.core.records import CFA_PATTERNS

PAIRS = {"RGGB": GREENS_RISE, "BGGR": GREENS_RISE, "GRBG": GREENS_FALL, "GBRG": GREENS_FALL}


def coded(seed, cfa, size=(72, 96), black=0.0):
    """Readings of a coloured scene that moves behind six masks, and how much they open."""
    rng = np.random.default_rng(seed)
    masks = (rng.random((6, *size)) < 0.4).astype(float)
    scene = gaussian_filter(rng.random((size[0], size[1] + 6, 3)), (4, 4, 0))
    scene = 0.1 + 0.8 * (scene - scene.min()) / np.ptp(scene)
    views = np.stack([scene[:, k : size[1] + k] for k in range(6)])
    image = np.einsum("nhw,nhwc->hwc", masks, views)
    if cfa is None:
        readings = image.mean(axis=2)
    else:
        channels = np.array(["RGB".index(letter) for letter in cfa]).reshape(2, 2)
        places = np.tile(channels, (size[0] // 2, size[1] // 2))
        readings = np.take_along_axis(image, places[..., None], axis=2)[..., 0]
    return readings + rng.normal(0, 0.01, size) + black, masks.sum(axis=0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("cfa", CFA_PATTERNS)
def test_the_greens_of_every_mosaic_are_found(cfa, seed):
    assert greens_of(*coded(seed, cfa)) == PAIRS[cfa]


def test_a_picture_that_begins_one_column_later_is_of_the_other_pair():
    readings, opened = coded(0, "RGGB")
    assert greens_of(readings[:, 1:], opened[:, 1:]) == GREENS_FALL
    assert greens_of(readings[1:, 1:], opened[1:, 1:]) == GREENS_RISE


@pytest.mark.parametrize("seed", range(20))
def test_one_colour_is_no_mosaic(seed):
    readings, opened = coded(seed, None)
    assert greens_of(readings, opened) is None
    columns = 0.1 * np.random.default_rng(seed).standard_normal(readings.shape[1])
    assert greens_of(readings + columns, opened) is None


def test_a_unit_and_a_black_level_do_not_matter():
    readings, opened = coded(1, "GBRG", black=0.1)
    assert greens_of(700 * readings, 255 * opened) == GREENS_FALL


@pytest.mark.parametrize("size", [(2, 96), (4, 8)])
def test_a_few_pixels_tell_nothing(size):
    assert greens_of(*coded(0, "RGGB", size)) is None


def test_no_light_tells_nothing():
    readings, opened = coded(0, "RGGB")
    assert greens_of(0 * readings, opened) is None
    assert greens_of(readings, 0 * opened) is None
