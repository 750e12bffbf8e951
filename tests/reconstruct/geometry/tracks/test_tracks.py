from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.geometry.path.motion import predict_positions
from gs2ci.reconstruct.geometry.tracks.tracks import (
    USUAL_TRACKS,
    Tracks,
    TrackSettings,
    find_corners,
    find_tracks,
    refine_tracks,
    within,
)


def follow(scene, settings=USUAL_TRACKS):
    reference = len(scene.views) // 2
    return find_tracks(scene.views, reference, find_corners(scene.views, reference, settings), settings)


def true_positions(scene, corners):
    at = corners.astype(int)
    return predict_positions(
        corners, scene.inverse_depth[at[:, 1], at[:, 0]].astype(float), scene.poses, scene.intrinsics
    )


@pytest.mark.parametrize("channels", [1, 3])
def test_tracks_follow_the_scene_in_the_renderers_pixel_convention(seen, channels):
    scene = seen(channels=channels, depths=(1.0, 1.0))
    tracks = follow(scene)
    assert len(tracks) > 50
    errors = tracks.positions - true_positions(scene, tracks.positions[:, tracks.reference])
    errors, elsewhere = np.delete(errors, 2, axis=1), np.delete(tracks.seen, 2, axis=1)
    found = errors[elsewhere]
    assert np.median(np.linalg.norm(found, axis=-1)) < 0.15
    # Half a pixel of offset would show here: zoom and rotation would not hide it.
    assert np.abs(np.median(found, axis=0)).max() < 0.05


@pytest.mark.parametrize("light", [0.12, 0.05, 0.02, 1e-3, 1e-5])
def test_tracks_of_a_dark_scene_are_those_of_a_bright_one(seen, light):
    scene = seen()
    dark = replace(scene, views=(np.float32(light) * scene.views).astype(np.float32))
    tracks, bright = follow(dark), follow(scene)
    assert len(tracks) > 0.8 * len(bright)
    assert tracks.seen.mean() > bright.seen.mean() - 0.1
    truth = true_positions(dark, tracks.positions[:, tracks.reference])
    assert np.median(np.linalg.norm(tracks.positions - truth, axis=-1)[tracks.seen]) < 0.15


def test_corners_lie_on_pixel_centres_half_a_pixel_from_the_edge(seen):
    views = np.zeros((1, 20, 20, 1), np.float32)
    views[0, 5:, 9:] = 1
    corner = find_corners(views, 0)[0]
    np.testing.assert_allclose(corner, (9, 5), atol=2)
    assert (corner % 1 == 0.5).all()


def test_refined_tracks_are_found_where_a_rough_prediction_points(seen):
    scene = seen(depths=(1.0, 1.0))
    corners = find_corners(scene.views, 2)
    rough = true_positions(scene, corners) + np.random.default_rng(0).uniform(-1, 1, (len(corners), 5, 2))
    rough[:, 2] = corners
    tracks = refine_tracks(scene.views, 2, rough)
    errors = (tracks.positions - true_positions(scene, corners))[tracks.seen]
    assert tracks.seen.mean() > 0.6
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.15


def test_a_view_without_texture_has_no_tracks():
    blank = np.full((3, 32, 32, 3), 0.5, np.float32)
    assert len(find_corners(blank, 1)) == 0
    assert len(find_tracks(blank, 1, np.empty((0, 2)))) == 0
    assert len(refine_tracks(blank, 1, np.empty((0, 3, 2)))) == 0


def test_a_view_of_something_else_is_not_seen(seen):
    scene = seen()
    scene.views[4] = seen(seed=9).views[4]
    tracks = follow(scene, TrackSettings(forward_backward_px=0.5))
    assert tracks.seen[:, 3].mean() > 0.5
    assert tracks.seen[:, 4].mean() < 0.2


def test_points_outside_the_image_are_not_seen(seen):
    scene = seen()
    tracks = follow(scene)
    inside = tracks.positions[tracks.seen]
    assert (inside >= 0.5).all()
    assert (inside <= (119.5, 89.5)).all()


def test_selection_counts_the_views_that_see_a_point():
    positions = np.zeros((3, 4, 2))
    positions[1, 2:] = np.nan
    positions[2, 3] = np.nan
    tracks = Tracks(positions, 0)
    assert len(tracks.seen_by_at_least(3)) == 2
    assert len(tracks.keep(np.array([True, False, False]))) == 1


@pytest.mark.parametrize("window_px", [1, 20, 999])
def test_a_window_without_a_middle_or_out_of_range_is_refused(window_px):
    with pytest.raises(InputError, match=f"window_px = {window_px} in TrackSettings"):
        TrackSettings(window_px=window_px).check()


@pytest.mark.parametrize("window_px", [9, 31])
def test_tracks_are_found_through_other_windows(seen, window_px):
    scene = seen(depths=(1.0, 1.0))
    settings = TrackSettings(window_px=window_px)
    tracks = follow(scene, settings)
    errors = (tracks.positions - true_positions(scene, tracks.positions[:, tracks.reference]))[tracks.seen]
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.15
    assert not np.array_equal(tracks.positions, follow(scene).positions)


def test_what_no_view_shows_is_forgotten():
    """A point whose corner lies where nothing is shown goes as a whole, a sighting there by itself."""
    shown = np.ones((20, 30), bool)
    shown[:, 25:] = False
    positions = np.array([[[10.0, 5], [26.5, 5]], [[26.0, 9], [11.0, 9]], [[3.0, 3], [24.9, 19.9]]])
    kept = within(Tracks(positions, 0), shown)
    np.testing.assert_array_equal(kept.positions, [[[10.0, 5], [np.nan, np.nan]], [[3.0, 3], [24.9, 19.9]]])
    assert len(within(Tracks(np.empty((0, 2, 2)), 0), shown)) == 0
