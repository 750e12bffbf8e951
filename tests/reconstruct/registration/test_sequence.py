"""Which view came first: told where views differ the more the further apart they are, and only there."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

from gs2ci.reconstruct.registration.sequence import find_beginning

COUNT = 7


def seen_from(places, noise=0.02):
    """Views of one wide picture from places along a line, px."""
    rng = np.random.default_rng(1)
    wide = gaussian_filter(rng.normal(0, 1, (40, 160)), 2.5)
    wide /= wide.std()
    columns = np.arange(40, 120)
    views = np.stack([[np.interp(columns + place, np.arange(160), row) for row in wide] for place in places])
    return (views + rng.normal(0, noise, views.shape)).astype(np.float32)[..., None]


@pytest.mark.parametrize("late", range(COUNT))
@pytest.mark.parametrize("places", [np.arange(COUNT), 0.1 * np.arange(COUNT) ** 2], ids=["even", "accelerating"])
def test_the_first_view_is_found(places, late):
    found = find_beginning(np.roll(seen_from(places), late, axis=0))
    assert found.first == late
    assert found.is_other == (late != 0)


@pytest.mark.parametrize(
    ("radius_px", "flat", "count", "seed"), [(2.5, 1.0, 12, 3), (2.5, 0.7, 16, 0), (6.0, 0.7, 12, 0), (6.0, 0.4, 16, 0)]
)
def test_a_camera_that_comes_back_to_where_it_began_stays_in_order(radius_px, flat, count, seed):
    """Round a circle, distances from a start half way on have rank correlations as high as along a line."""
    rng = np.random.default_rng(seed)
    wide = gaussian_filter(rng.normal(0, 1, (120, 120)), 2.5)
    angles = 2 * np.pi * np.linspace(-0.5, 0.5, count)
    places = radius_px * np.stack([np.cos(angles), flat * np.sin(angles)], axis=1)
    views = np.stack([shift(wide, place, order=1)[20:100, 20:100] for place in places]) / wide.std()
    views = (views + rng.normal(0, 0.1, views.shape)).astype(np.float32)[..., None]
    assert not find_beginning(views).is_other


def test_the_reversed_sequence_ranks_the_same():
    views = seen_from(np.arange(COUNT))
    assert find_beginning(views[::-1]).rank == pytest.approx(find_beginning(views).rank)


@pytest.mark.parametrize(
    "places",
    [
        np.zeros(COUNT),
        [0, 1, 2, 3, 2, 1, 0],
        [0, 2, 4, 4, 2, 0, 0],
        [0.0, 1.1, -0.7, 0.4, -1.2, 0.8, -0.1],
        2 * np.sin(2 * np.pi * np.arange(COUNT) / COUNT),
        [0, 1, 2, 8, 9, 10, 11],
    ],
    ids=["at rest", "to and fro", "with a stop", "trembling", "a whole period", "a jolt"],
)
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_right_orders_of_any_motion_stay(places, noise):
    found = find_beginning(seen_from(places, noise))
    assert found is None or not found.is_other


def test_a_rotated_turn_and_return_is_not_concluded_from():
    found = find_beginning(np.roll(seen_from([0, 1, 2, 3, 2, 1, 0]), 3, axis=0))
    assert not found.is_other


@pytest.mark.parametrize(
    "views",
    [seen_from([0, 1, 2]), np.full((5, 8, 8, 1), 0.3, np.float32), np.full((5, 8, 8, 1), np.nan, np.float32)],
    ids=["three", "alike", "not finite"],
)
def test_nothing_is_said_where_nothing_tells(views):
    assert find_beginning(views) is None


@pytest.mark.parametrize("count", [4, 5, 6, 7, 8])
def test_unrelated_views_hardly_ever_seem_to_begin_elsewhere(count):
    """Of four views one in six would, by the threshold that is right for eight."""
    rng = np.random.default_rng(count)
    found = [find_beginning(rng.normal(size=(count, 2, 2, 1)).astype(np.float32)) for _ in range(400)]
    assert sum(one is not None and one.is_other for one in found) <= 4
