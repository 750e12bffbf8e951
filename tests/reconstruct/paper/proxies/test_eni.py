import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.reconstruct.paper.proxies.routing import complete, energy_normalised_views, masked_measurements


def ramp(size, channels=1):
    y, x = np.mgrid[: size[0], : size[1]]
    return np.stack([0.1 + 0.01 * (c + 1) * x + 0.02 * y for c in range(channels)], axis=-1)


def test_samples_keep_their_normalised_values(make_shot, random_masks):
    masks = random_masks(3, (20, 24), 0.4)
    shot = make_shot(masks, np.random.default_rng(0).random((3, 20, 24, 3)), channels=3)
    views = energy_normalised_views(shot)
    exposure = masks.sum(axis=0)[..., None]
    normalised = shot.measurement / np.where(exposure > 0, exposure, 1)
    for view, mask in zip(views, masks, strict=True):
        assert np.allclose(view[mask > 0], normalised[mask > 0], atol=1e-6)


def test_completion_is_exact_on_a_ramp_inside_the_hull_and_nearest_outside():
    rng = np.random.default_rng(0)
    known = rng.random((30, 34)) < 0.2
    known[:5] = False
    known[[5, 5, -1, -1], [0, -1, 0, -1]] = True
    values = ramp(known.shape, 2)
    filled = complete(np.where(known[..., None], values, np.nan), known)
    assert np.abs(filled - values)[5:].max() < 1e-9
    points = np.argwhere(known)
    for r, c in np.argwhere(~known[:5]):
        distances = ((points - (r, c)) ** 2).sum(axis=1)
        ties = values[tuple(points[distances == distances.min()].T)]
        assert (np.abs(ties - filled[r, c]).max(axis=1) < 1e-12).any()


@pytest.mark.parametrize("where", [([3], [4]), ([3, 9], [4, 4]), ([1, 2, 3], [1, 2, 3]), ([0, 0, 0, 0], [1, 4, 6, 9])])
def test_samples_that_span_no_triangle_are_continued_by_the_nearest(where):
    known = np.zeros((12, 12), bool)
    known[where] = True
    values = np.random.default_rng(0).random((12, 12, 1))
    filled = complete(values, known)
    assert np.isfinite(filled).all()
    assert set(filled.ravel()) == set(values[known].ravel())


def test_pixels_that_no_mask_opens_are_interpolated(make_shot, random_masks):
    masks = random_masks(3, (20, 20), 0.6)
    masks[:, 8:11, 8:11] = 0
    views = np.broadcast_to(ramp((20, 20)), (3, 20, 20, 1))
    found = energy_normalised_views(make_shot(masks, views))
    assert np.abs(found - views)[:, 8:11, 8:11].max() < 1e-6


def test_a_grey_mask_takes_its_samples_from_half_of_its_open_level_on(make_shot):
    masks = np.zeros((2, 10, 10))
    masks[0, ::2], masks[0, 1::2] = 0.4, 0.05
    masks[1, ::2], masks[1, 1::2] = 0.02, 0.3
    bright = np.stack([np.full((10, 10, 1), 0.2), np.full((10, 10, 1), 0.8)])
    views = energy_normalised_views(make_shot(masks, bright))
    assert np.allclose(views[0], (0.4 * 0.2 + 0.02 * 0.8) / 0.42, atol=1e-6)
    assert np.allclose(views[1], (0.05 * 0.2 + 0.3 * 0.8) / 0.35, atol=1e-6)


def test_slot_weights_count_in_the_exposure(make_shot):
    masks = np.ones((2, 6, 6))
    views = energy_normalised_views(make_shot(masks, np.full((2, 6, 6, 1), 0.5), weights=[1, 0.25]))
    assert np.allclose(views, 0.5, atol=1e-6)


def test_a_view_behind_a_closed_mask_is_completed_from_all_samples(make_shot):
    masks = np.ones((2, 6, 6))
    masks[1] = 0
    views = energy_normalised_views(make_shot(masks, np.full((2, 6, 6, 1), 0.5)))
    assert np.allclose(views, 0.5, atol=1e-6)


def test_each_colour_of_a_mosaic_is_completed_from_its_own_pixels(make_shot, random_masks):
    masks = random_masks(2, (24, 24), 0.5)
    colours = cfa_channels("GRBG", (24, 24)).numpy()
    truth = ramp((24, 24), 3)
    measured = masks.sum(axis=0) * np.take_along_axis(truth, colours[..., None], axis=2)[..., 0]
    shot = make_shot(masks, measurement=measured[..., None].astype(np.float32), cfa="GRBG")
    views = energy_normalised_views(shot)
    assert views.shape == (2, 24, 24, 3)
    assert np.abs(views - truth)[:, 6:18, 6:18].max() < 1e-6


def test_saturated_pixels_are_no_samples(make_shot, random_masks):
    masks = random_masks(2, (16, 16), 0.7)
    saturated = np.random.default_rng(2).random((16, 16)) < 0.1
    clean = make_shot(masks, saturated=saturated)
    spoilt = np.where(saturated[..., None], 50, clean.measurement).astype(np.float32)
    again = make_shot(masks, measurement=spoilt, saturated=saturated)
    assert np.array_equal(energy_normalised_views(again), energy_normalised_views(clean))


def test_a_measurement_without_a_pixel_that_counts_is_refused(make_shot, random_masks):
    shot = make_shot(random_masks(2, (8, 8)), saturated=np.ones((8, 8), bool))
    with pytest.raises(InputError, match="open in any mask"):
        energy_normalised_views(shot)


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
