from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.cameras import in_camera
from gs2ci.reconstruct.uncertainty.depths import error_of_places, errors_of_depths, movement
from gs2ci.reconstruct.uncertainty.factors import factors
from tests.reconstruct.uncertainty.conftest import path


def stated(seen, place_px=factors.place_px, turn=0.0, others=None):
    return errors_of_depths(seen, place_px, turn, others)


def followed(seen, depth, noise=0.0):
    """Slopes of points of view 3, at a depth of their own, in all views."""
    rays = seen.rays.reshape(-1, 2)[::5].astype(np.float64)
    deep = depth[3].reshape(-1)[::5, None].astype(np.float64)
    there = np.stack([in_camera(np.hstack([rays * deep, deep]), pose) for pose in seen.world_to_camera], axis=1)
    slopes = there[..., :2] / there[..., 2:]
    slopes += noise * np.random.default_rng(0).standard_normal(slopes.shape) / 35
    slopes[:, 3] = rays
    return slopes


def test_there_is_an_error_where_there_is_a_depth_and_none_larger_than_it(seen):
    depth = seen.depth.copy()
    depth[:, :3] = 0
    found = stated(replace(seen, depth=depth), turn=5.0)
    assert found.dtype == np.float32
    assert np.array_equal(found > 0, depth > 0)
    assert (found <= depth).all()


def test_far_things_that_move_little_through_the_views_are_less_sure(seen):
    far = seen.depth.copy()
    far[..., 16:] = 30.0
    relative = stated(replace(seen, depth=far)) / far
    assert relative[:, :, 24].mean() > 4 * relative[:, :, 8].mean()


def test_places_that_are_less_sure_make_depths_so(seen):
    sure, unsure = stated(seen, 0.2), stated(seen, 0.4)
    assert np.allclose(unsure[3, 5, 5], 2 * sure[3, 5, 5], rtol=1e-3)


def test_a_turn_that_the_stage_states_shifts_all_depths_and_those_that_move_little_the_most(seen):
    far = seen.depth.copy()
    far[..., 16:] *= 1.5
    plain = replace(seen, depth=far)
    turn = 1e-3
    sure, unsure = (errors_of_depths(plain, 0.25, 0.0, None, stated) / far for stated in (0.0, turn))
    added = np.sqrt(unsure**2 - sure**2)
    points = torch.from_numpy(np.concatenate([seen.rays * far[3, ..., None], far[3, ..., None]], axis=-1)).double()
    moved = movement(seen.world_to_camera, seen.focal_px, 3, points.unbind(dim=-1)).numpy()
    turned_px = turn * seen.focal_px.mean() * len(far) ** 0.5
    assert np.allclose(added[3, 4:-4, 4:12], (turned_px / moved)[4:-4, 4:12], rtol=1e-2)
    assert added[3, :, 20:].mean() > 1.3 * added[3, :, :12].mean()


def test_light_that_is_stopped_over_a_range_of_depths_leaves_open_which_of_them_it_is(seen):
    spread = np.zeros_like(seen.spread)
    spread[..., 16] = 0.2
    found, sharp = stated(replace(seen, spread=spread)), stated(seen)
    added = np.sqrt(found**2 - sharp**2) / seen.depth
    assert np.allclose(added[..., 16], 0.2)
    assert not np.delete(added, 16, axis=2).any()


def test_tracks_on_the_depths_found_show_no_error_of_places_at_any_scale(seen):
    assert error_of_places(seen, 3, followed(seen, seen.depth)) == pytest.approx(0, abs=1e-6)
    larger = replace(seen, depth=1.1 * seen.depth)
    assert error_of_places(larger, 3, followed(seen, seen.depth)) < 0.05


def test_depths_left_at_those_of_their_surroundings_err_by_what_tracks_show(seen):
    """Half of the points lie at 2 × 1.2 and 3 × 1.2, scattered among the others: the mean is no error, the rest is.

    Tracks may be wrong as well as depths.
    """
    true = seen.depth.copy()
    true[:, ::2, ::2] *= 1.2
    true[:, 1::2, 1::2] *= 1.2
    found = error_of_places(seen, 3, followed(seen, true))
    poses, points = seen.world_to_camera, torch.tensor([0.0, 0, 2], dtype=torch.float64).unbind()
    moved = float(movement(poses, seen.focal_px, 3, points))
    assert found == pytest.approx(0.1 * moved / np.sqrt(2), rel=0.4)
    noisy = error_of_places(seen, 3, followed(seen, true, noise=0.5))
    assert noisy > found


def test_what_the_spread_of_light_along_the_ray_puts_beside_is_not_counted_again(seen):
    true = seen.depth.copy()
    true[:, ::2] *= 1.1
    there = followed(seen, true)
    alone, half, whole = (
        error_of_places(replace(seen, spread=np.full_like(seen.spread, one)), 3, there) for one in (0, 0.02, 0.1)
    )
    assert alone > half > 0
    assert whole == 0


def test_points_that_few_views_see_or_that_have_no_depth_do_not_tell_of_places(seen):
    there = followed(seen, seen.depth)
    lost = there.copy()
    lost[:10, :3], lost[:10, 4:] = np.nan, np.nan
    lost[10:20, 0] += 3  # only where its depth is known
    depth = seen.depth.copy()
    depth.reshape(len(depth), -1)[:, 50:100] = 0
    assert error_of_places(replace(seen, depth=depth), 3, lost) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("points", [None, np.empty((0, 6, 2)), np.full((4, 6, 2), np.nan)])
def test_without_tracked_points_places_err_as_is_usual(seen, points):
    assert error_of_places(seen, 3, points) == factors.untracked_px


@pytest.mark.parametrize("log", [0.1, 0.3, 0.5, 1.0])
def test_a_turn_leaves_relief_open_and_what_of_it_may_be_missing(seen, log):
    """A turn by 0.1 px in the mean over a path whose mean travel moves a depth by t px is 0.1 / t of its relief."""
    far = 2 * np.exp(log)
    depth = np.where(seen.depth > 2, far, 2).astype(np.float32)
    depth[0] = 2  # so that this is the middle depth
    grown = [stated(replace(seen, depth=depth), turn=turn)[3, 12, 26] / far for turn in (0.0, 0.1 / 35)]
    travel_px = 35 * 0.2 / far * np.std(np.linspace(-0.5, 0.5, 6))
    expected = 0.1 / travel_px * np.hypot(1 - 2 / far, max(factors.unknown_depth - log, 0))
    assert np.sqrt(grown[1] ** 2 - grown[0] ** 2) == pytest.approx(expected, rel=0.03)


def test_a_turn_makes_depths_before_a_camera_that_drives_into_a_scene_unsure_near_its_way(seen):
    poses = path(6, (0, 0, 0.4))
    relative = stated(replace(seen, world_to_camera=poses), turn=0.002) / seen.depth
    assert relative[3, 12, 18] > 1.5 * relative[3, 2, 30]


@pytest.mark.parametrize("count", [1, 6])
def test_a_camera_at_rest_tells_no_depth(seen, count):
    still = replace(
        seen,
        views=seen.views[:count],
        depth=seen.depth[:count],
        spread=seen.spread[:count],
        world_to_camera=path(count, (0, 0, 0)),
        transmissions=seen.transmissions[:count],
    )
    assert np.allclose(stated(still), still.depth)


def test_without_any_depth_there_is_no_error(seen):
    assert not stated(replace(seen, depth=np.zeros_like(seen.depth))).any()


def test_a_point_moves_by_the_parallax_of_its_depth():
    poses = path(5)
    near, far = (torch.tensor([0, 0, depth], dtype=torch.float64).unbind() for depth in (2.0, 1e6))
    found = movement(poses, np.array([35.0, 35.0]), 2, near)
    places = 35 * np.linspace(-0.1, 0.1, 5) / 2
    assert float(found) == pytest.approx(np.sqrt(np.square(places).sum()))
    assert float(movement(poses, np.array([35.0, 35.0]), 2, far)) == factors.place_px
