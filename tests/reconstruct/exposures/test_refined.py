"""Depth maps and paths that agree with corners seen by several exposures."""

import numpy as np

from gs2ci.reconstruct.exposures import refined as module
from gs2ci.reconstruct.exposures.refined import refined
from tests.reconstruct.exposures.rooms import PLACES, UNITS, VIEWS, path, truly


def test_a_map_is_stretched_and_offset_to_fit_its_corners_despite_wrong_ones():
    rng = np.random.default_rng(0)
    given = rng.uniform(0.5, 1.5, (20, 30)).astype(np.float32)
    pixels = rng.uniform((0, 0), (30, 20), (80, 2))
    columns, rows = pixels.astype(int).T
    known = 0.7 * given[rows, columns] + 0.2
    known[:8] = 3.0
    found = module._map(given, pixels, 1 / known)
    np.testing.assert_allclose(found, 0.7 * given + 0.2, atol=0.02)
    assert found.dtype == np.float32


def test_views_are_placed_among_the_corners_and_those_that_see_few_keep_their_pose(four):
    one = four[0]
    (picture,) = module.pictures_of(one.views, one.geometry)
    pixels = np.stack(np.meshgrid(np.arange(12.0, 120, 9), np.arange(12.0, 90, 9)), axis=-1).reshape(-1, 2)
    wrong = one.geometry.world_to_camera.copy()
    wrong[0, 0, 3] += 0.02
    views = one.views.copy()
    views[2] = 0.5
    geometry = module.replace(one.geometry, world_to_camera=wrong)
    found = module._path(geometry, views, pixels, picture.lifted(pixels))
    true = path(PLACES[0]) @ np.linalg.inv(path(PLACES[0])[1])
    true[:, :3, 3] /= UNITS[0]
    assert abs(found[0, 0, 3] - true[0, 0, 3]) < 0.006
    np.testing.assert_array_equal(found[1:], wrong[1:])


def test_too_few_corners_leave_depths_and_paths(four, monkeypatch):
    monkeypatch.setattr(module, "_LEAST_CORNERS", 10_000)
    views, geometries = (
        {k: one.views for k, one in enumerate(four[:2])},
        {k: one.geometry for k, one in enumerate(four[:2])},
    )
    found = refined(views, geometries, dict(enumerate(truly(PLACES[:2], UNITS[:2]))), [(0, 1)])
    assert found.geometries == geometries
    assert found.corners[0] > 50
    assert found.distance_px < 0.5
    assert len(found.geometries[0].world_to_camera) == VIEWS


def test_exposures_that_see_no_corner_of_each_other_keep_their_similarities(four):
    views = {0: four[0].views, 1: np.full_like(four[1].views, 0.5)}
    similarities = dict(enumerate(truly(PLACES[:2], UNITS[:2])))
    found = refined(views, {0: four[0].geometry, 1: four[1].geometry}, similarities, [(0, 1)])
    np.testing.assert_allclose(found.similarities[1].translation, similarities[1].translation)
    assert found.distance_px is None
