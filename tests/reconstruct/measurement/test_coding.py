import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.records import CFA_PATTERNS, Shot
from gs2ci.reconstruct.measurement.coding import (
    Coding,
    beyond_white,
    cfa_channels,
    select,
    white_reading,
    without_pixels,
)

SIZE = (5, 7)


def coding(pattern, dtype):
    generator = torch.Generator().manual_seed(3)
    transmissions = torch.rand(4, *SIZE, generator=generator, dtype=dtype)
    return Coding(transmissions, None if pattern is None else cfa_channels(pattern, SIZE))


def draw(*shape, dtype, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


@pytest.mark.parametrize("pattern", [None, *CFA_PATTERNS])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-13), (torch.float32, 1e-5)])
class TestLaws:
    def test_forward_is_linear(self, pattern, dtype, tolerance):
        phi = coding(pattern, dtype)
        a, b = draw(4, *SIZE, 3, dtype=dtype, seed=0), draw(4, *SIZE, 3, dtype=dtype, seed=1)
        torch.testing.assert_close(
            phi.forward(2 * a - 3 * b), 2 * phi.forward(a) - 3 * phi.forward(b), rtol=tolerance, atol=10 * tolerance
        )

    def test_forward_keeps_the_precision_of_the_masks(self, pattern, dtype, tolerance):
        phi = coding(pattern, dtype)
        assert phi.forward(draw(4, *SIZE, 3, dtype=dtype, seed=0)).dtype == dtype


def test_forward_sums_masked_views_as_the_equation_says():
    phi = coding(None, torch.float64)
    views = draw(4, *SIZE, 3, dtype=torch.float64, seed=0)
    expected = sum(phi.transmissions[i, :, :, None] * views[i] for i in range(4))
    torch.testing.assert_close(phi.forward(views), expected)


def test_weights_scale_the_masks_of_a_shot():
    masks = np.ones((2, *SIZE), np.float32)
    shot = Shot(np.ones((*SIZE, 1), np.float32), masks, np.array([0.25, 0.5], np.float32))
    assert Coding.of(shot).forward(torch.ones(2, *SIZE, 1)).unique().tolist() == [0.75]


def test_cfa_channels_repeat_their_cell_from_the_top_left_pixel():
    assert cfa_channels("GRBG", (3, 3)).tolist() == [[1, 0, 1], [2, 1, 2], [1, 0, 1]]


def test_unknown_pattern_is_refused():
    with pytest.raises(InputError, match="RGGB"):
        cfa_channels("RGBW", SIZE)


@pytest.mark.parametrize("shape", [(3, *SIZE, 3), (4, *SIZE, 2), (4, 7, 5, 3)])
def test_forward_refuses_views_that_do_not_fit(shape):
    with pytest.raises(InputError, match="views of shape"):
        coding(None, torch.float32).forward(torch.zeros(shape))


def test_forward_refuses_mono_views_behind_a_colour_filter_array():
    with pytest.raises(InputError, match="views of shape"):
        coding("RGGB", torch.float32).forward(torch.zeros(4, *SIZE, 1))


def test_select_sees_of_each_pixel_only_its_own_colour():
    channels = cfa_channels("RGGB", SIZE)
    image = draw(*SIZE, 3, dtype=torch.float64, seed=0)
    mosaic = select(image, channels)
    assert mosaic.shape == (*SIZE, 1)
    assert mosaic[1, 2, 0] == image[1, 2, channels[1, 2]]


def test_a_white_scene_reads_what_its_coding_says_and_nothing_of_it_is_beyond_white():
    rng = np.random.default_rng(0)
    masks, weights = rng.random((3, *SIZE)).astype(np.float32), np.array([0.5, 1, 2], np.float32)
    white = np.einsum("n,nhw->hw", weights, masks)[..., None]
    shot = Shot(white, masks, weights)
    np.testing.assert_allclose(white_reading(shot)[..., None], white, rtol=1e-6)
    assert not beyond_white(shot).any()
    white[2, 3] = 1.05 * white[2, 3] + 0.06
    assert np.argwhere(beyond_white(shot)).tolist() == [[2, 3]]


def test_pixels_that_are_left_out_have_no_mask_and_no_reading():
    rng = np.random.default_rng(1)
    shot = Shot(rng.normal(size=(*SIZE, 3)).astype(np.float32), np.ones((2, *SIZE), np.float32), np.ones(2, np.float32))
    gone = rng.random(SIZE) < 0.3
    left = without_pixels(shot, gone)
    assert not left.lit[gone].any()
    assert not left.measurement[gone].any()
    np.testing.assert_array_equal(left.measurement[~gone], shot.measurement[~gone])
    np.testing.assert_array_equal(left.masks[:, ~gone], shot.masks[:, ~gone])
