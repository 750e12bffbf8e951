import numpy as np
import pytest
import torch

from gs2ci.core.records import CFA_PATTERNS
from gs2ci.reconstruct.decode.demosaic import Demosaicer
from gs2ci.reconstruct.measurement.coding import cfa_channels, select


def mosaic_of(image, pattern):
    channels = cfa_channels(pattern, image.shape[:2])
    return select(torch.from_numpy(image), channels)[..., 0].numpy(), channels.numpy()


@pytest.mark.parametrize("pattern", CFA_PATTERNS)
def test_measured_colours_are_kept(pattern):
    image = np.random.default_rng(0).random((9, 12, 3)).astype(np.float32)
    mosaic, channels = mosaic_of(image, pattern)
    colour = Demosaicer(channels)(mosaic)
    np.testing.assert_allclose(np.take_along_axis(colour, channels[None], 0)[0], mosaic, atol=1e-6)


@pytest.mark.parametrize("pattern", CFA_PATTERNS)
def test_a_grey_ramp_is_reconstructed_away_from_the_border(pattern):
    y, x = np.mgrid[0:12, 0:14].astype(np.float32)
    image = np.repeat((0.2 + 0.03 * x + 0.02 * y)[..., None], 3, axis=2)
    mosaic, channels = mosaic_of(image, pattern)
    colour = Demosaicer(channels)(mosaic).transpose(1, 2, 0)
    np.testing.assert_allclose(colour[2:-2, 2:-2], image[2:-2, 2:-2], atol=1e-6)


def test_it_is_linear():
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 8, 8)).astype(np.float32)
    demosaic = Demosaicer(cfa_channels("BGGR", (8, 8)).numpy())
    np.testing.assert_allclose(demosaic(2 * a - b), 2 * demosaic(a) - demosaic(b), atol=1e-5)


def test_a_single_row_that_misses_a_colour_stays_finite():
    channels = cfa_channels("RGGB", (1, 6)).numpy()
    assert np.isfinite(Demosaicer(channels)(np.ones((1, 6), np.float32))).all()
