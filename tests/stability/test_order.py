"""Whether a case's data determine near and far, and when a rank correlation is chance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci_sims.path import StageMove
from tests.stability.benches import Bench, aside, build, still, turning
from tests.stability.order import (
    DROWNS_PX,
    EVEN_PER_PX,
    beyond_a_turn_px,
    by_chance,
    rank_error,
    texture_per_px,
    unknowable,
)
from tests.tables.order import depth_rank

SIZE = (48, 64)


def opened(bench):
    return unknowable(bench.expose(SIZE), build(bench.scene, SIZE))


@pytest.mark.parametrize(
    "bench",
    [Bench(), Bench(views=2), Bench(parallax_px=8.0), Bench("boxes"), Bench("chequerboard", path=aside(0.3))],
    ids=["easy", "two views", "much parallax", "boxes", "a wall passed far aside"],
)
def test_where_parallax_and_texture_are_there_the_order_can_be_known(bench):
    assert opened(bench) == ""


@pytest.mark.parametrize(
    "bench",
    [Bench(path=still), Bench(path=turning(15)), Bench(parallax_px=1.0), Bench("spots", path=aside(0.05))],
    ids=["at rest", "turned", "a pixel", "a wall passed by little"],
)
def test_a_motion_that_a_turn_explains_leaves_the_order_open(bench):
    assert "a turn explains" in opened(bench)


@pytest.mark.parametrize("scene", ["black wall", "grey wall", "soft gradient"])
def test_a_scene_that_shows_nothing_leaves_the_order_open_however_far_the_camera_goes(scene):
    assert opened(Bench(scene, path=aside(0.3))) == "the scene shows nothing to follow"


def test_without_a_truth_nothing_is_said_to_be_open():
    shot = Bench(path=still).expose(SIZE)
    assert unknowable(replace(shot, truth=type(shot.truth)()), build("planes", SIZE)) == ""


def test_what_a_turn_leaves_of_two_planes_is_half_their_parallax():
    """Half of the points shift 1 px more than the others: a turn takes the mean, and 0.5 px is left of each."""
    focal = 1000.0
    depth = np.where(np.arange(64) % 2 < 1, 10.0, 20.0) * np.ones((48, 1))
    # Columns alternate under the grid of points as well.
    path = StageMove((20.0 / focal, 0.0, 0.0)).world_to_camera(np.array([0.0, 1.0]))
    camera = np.array([[focal, 0, 32], [0, focal, 24], [0, 0, 1]])
    assert beyond_a_turn_px(path, depth, camera) == pytest.approx(0.5, rel=0.05)
    assert beyond_a_turn_px(path, np.full((48, 64), np.nan), camera) == 0
    assert beyond_a_turn_px(path[:1], depth, camera) == 0
    assert beyond_a_turn_px(path, np.full((48, 64), 10.0), camera) < 0.1 < DROWNS_PX


def test_texture_is_the_change_from_pixel_to_pixel():
    ramp = np.broadcast_to(0.01 * np.arange(20)[None, None, :, None], (2, 10, 20, 3))
    assert texture_per_px(ramp) == pytest.approx(0.01)
    assert texture_per_px(np.zeros((2, 1, 1, 3))) == 0 < EVEN_PER_PX


def smooth(seed, sigma, size=SIZE):
    return 3 + gaussian_filter(np.random.default_rng(seed).normal(size=size), sigma, mode="wrap") * (1 + 2 * sigma)


@pytest.mark.parametrize(("sigma", "times"), [(0.1, 0.9), (1.0, 1.5), (4.0, 3.0)])
def test_the_standard_error_of_a_rank_is_what_unrelated_maps_scatter_by(sigma, times):
    pairs = [(smooth(2 * n, sigma), smooth(2 * n + 1, sigma)) for n in range(100)]
    ranks = np.array([depth_rank(*pair) for pair in pairs])
    errors = np.array([rank_error(*pair) for pair in pairs])
    # A hundred draws know their own scatter to 7 %.
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(ranks.std(), rel=0.3)
    # Far above that of as many independent pixels, unless they are.
    assert errors.mean() > times / np.sqrt(48 * 64)


def test_unknown_depths_count_for_no_error():
    found, true = smooth(0, 2), smooth(1, 2)
    whole = rank_error(found[:, :40], true[:, :40])
    found[:, 40:], true[0, 0] = 0, np.nan
    assert rank_error(found, true) == pytest.approx(whole, rel=0.02)
    assert rank_error(np.zeros(SIZE), true) == rank_error(np.full(SIZE, 2.0), true) == 0


@pytest.mark.parametrize(
    ("rank", "error", "chance"),
    [(-0.05, 0.04, True), (-0.05, 0.02, False), (0.05, 0.04, True), (-0.35, 0.4, False), (-0.29, 0.4, True)],
)
def test_a_rank_is_chance_within_two_of_its_errors_unless_it_is_clearly_negative(rank, error, chance):
    assert by_chance(rank, error) is chance
