import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.masks import random_masks
from tests.sims.grey_masks import random_grey_masks


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("ratio", [0.1, 0.25, 0.5])
def test_masks_are_binary_and_open_to_the_given_share(ratio):
    masks = random_masks(8, (200, 300), ratio, rng())
    assert masks.shape == (8, 200, 300)
    assert masks.dtype == np.float32
    assert set(np.unique(masks)) == {0.0, 1.0}
    assert masks.mean() == pytest.approx(ratio, abs=5 * (ratio * (1 - ratio) / masks.size) ** 0.5)


def test_the_number_of_open_masks_at_a_pixel_is_binomial():
    multiplicity = random_masks(8, (300, 300), 0.25, rng()).sum(axis=0)
    assert multiplicity.mean() == pytest.approx(2.0, abs=0.03)
    assert multiplicity.var() == pytest.approx(8 * 0.25 * 0.75, rel=0.03)


def test_a_ratio_of_one_opens_everything():
    assert random_masks(2, (5, 6), 1.0, rng()).all()


def test_features_are_squares_of_the_given_side_and_may_be_cut_at_the_border():
    masks = random_masks(1, (10, 13), 0.5, rng(), feature_px=4)[0]
    assert masks.shape == (10, 13)
    for row, column in ((0, 0), (4, 8), (8, 12)):
        block = masks[row : row + 4, column : column + 4]
        assert (block == block[0, 0]).all()


def test_the_same_generator_gives_the_same_masks():
    assert np.array_equal(random_masks(3, (9, 9), 0.3, rng(4)), random_masks(3, (9, 9), 0.3, rng(4)))


@pytest.mark.parametrize("ratio", [0.1, 0.25, 0.5, 0.75])
def test_grey_masks_have_the_mean_asked_for_and_a_third_of_the_variance_of_binary_ones(ratio):
    masks = random_grey_masks(8, (200, 300), ratio, rng())
    assert (masks.shape, masks.dtype) == ((8, 200, 300), np.float32)
    assert 0 <= masks.min() <= masks.max() <= 1
    assert masks.mean() == pytest.approx(ratio, abs=0.003)
    assert masks.var() == pytest.approx(ratio * (1 - ratio) / 3, rel=0.02)


def test_grey_masks_that_are_half_open_on_average_take_every_value_alike():
    masks = random_grey_masks(8, (100, 150), 0.5, rng())
    counts, _ = np.histogram(masks, bins=10, range=(0, 1))
    np.testing.assert_allclose(counts / masks.size, 0.1, atol=0.005)
    assert len(np.unique(masks)) > 0.9 * masks.size


def test_features_of_grey_masks_are_even_squares():
    masks = random_grey_masks(1, (10, 13), 0.5, rng(), feature_px=4)[0]
    assert masks.shape == (10, 13)
    assert (masks[8:10, 8:12] == masks[8, 8]).all()
    assert masks[0, 0] != masks[0, 4]


@pytest.mark.parametrize(
    ("count", "size", "ratio", "feature_px"),
    [(0, (4, 4), 0.5, 1), (2, (0, 4), 0.5, 1), (2, (4, 4), 0.0, 1), (2, (4, 4), 1.1, 1), (2, (4, 4), 0.5, 0)],
)
def test_figures_out_of_range_are_refused(count, size, ratio, feature_px):
    with pytest.raises(InputError, match="allowed"):
        random_masks(count, size, ratio, rng(), feature_px=feature_px)


def test_masks_that_all_came_out_closed_are_refused():
    with pytest.raises(InputError, match="came out closed"):
        random_masks(1, (1, 1), 1e-9, rng())
