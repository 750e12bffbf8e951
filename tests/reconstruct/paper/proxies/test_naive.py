import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.naive import masked_measurements


@pytest.fixture
def masks():
    return (np.random.default_rng(0).random((3, 8, 8)) < 0.6).astype(np.float32)


def test_each_view_is_the_measurement_under_its_mask(masks):
    rng = np.random.default_rng(1)
    measured, weights = rng.random((8, 8, 3)).astype(np.float32), np.array([1, 0.5, 0.25], np.float32)
    views = masked_measurements(Shot(measured, masks, weights).check())
    expected = weights[:, None, None, None] * masks[..., None] * measured
    assert np.allclose(views, expected, atol=1e-6)
    assert views.dtype == np.float32


def test_a_mosaic_has_all_colours_where_a_mask_is_open_and_is_dark_elsewhere(masks):
    colours = np.array([0.2, 0.4, 0.6], np.float32)
    measured = np.full((8, 8, 1), colours[1])
    measured[::2, ::2], measured[1::2, 1::2] = colours[0], colours[2]
    views = masked_measurements(Shot(measured, masks, np.ones(3, np.float32), cfa="RGGB").check())
    assert np.allclose(views, masks[..., None] * colours, atol=1e-6)


def test_a_saturated_pixel_takes_its_neighbours_word(masks):
    measured, saturated = np.full((8, 8, 1), 0.5, np.float32), np.zeros((8, 8), bool)
    measured[4, 4], saturated[4, 4] = 9, True
    views = masked_measurements(Shot(measured, masks, np.ones(3, np.float32), saturated=saturated).check())
    assert views.max() == pytest.approx(0.5)


def test_nothing_is_seen_where_no_pixel_counts():
    masks = np.ones((2, 4, 4), np.float32)
    shot = Shot(np.ones((4, 4, 1), np.float32), masks, np.ones(2, np.float32), saturated=np.ones((4, 4), bool))
    assert not masked_measurements(shot).any()
