"""Filling on drawn maps, where what is missing is known."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.scenes.layers import (
    RIM_PX,
    Layer,
    clean_rims,
    fill_holes,
    hidden_layer,
    without_flying_pixels,
)

SHAPE = (60, 80)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]]
FLOOR = 10 + 0.05 * ROWS  # a slanted background
BLOCK = (abs(ROWS - 30) < 15) & (abs(COLUMNS - 40) < 20)


def scene(block_disparity=40.0):
    background = np.stack([COLUMNS / 80, 0.5 + 0.5 * np.sin(ROWS), np.zeros(SHAPE)], -1)
    colour = np.where(BLOCK[..., None], [0.0, 0.0, 1.0], background)
    return Layer(np.where(BLOCK, block_disparity, FLOOR), colour, np.ones(SHAPE, dtype=bool))


def depth_in_block():
    inside_y = 15 - abs(ROWS - 30)
    inside_x = 20 - abs(COLUMNS - 40)
    return np.where(BLOCK, np.minimum(inside_x, inside_y), 0)


def test_the_background_goes_on_behind_the_block_as_far_as_the_camera_sees():
    hidden = hidden_layer(scene(), jump=1.0, reach=0.2)
    furthest = 0.2 * 30
    inside = depth_in_block()
    assert hidden.present[(inside > 0) & (inside < furthest - 1)].all()
    assert not hidden.present[inside > furthest + 1].any()
    assert not hidden.present[~BLOCK].any()


def test_a_longer_reach_hides_nothing_less():
    near, far = (hidden_layer(scene(), 1.0, reach).present for reach in (0.1, 0.4))
    assert (far | ~near).all()
    assert far.sum() > near.sum()


def test_hidden_disparities_go_on_with_the_slanted_background_and_stay_behind():
    hidden = hidden_layer(scene(), 1.0, 0.3)
    assert np.abs(hidden.disparity - FLOOR)[hidden.present].max() < 0.5
    assert (hidden.disparity < 40 - 1.0)[hidden.present].all()


def test_hidden_colours_are_those_of_the_background_not_of_the_block():
    hidden = hidden_layer(clean_rims(scene(), 1.0), 1.0, 0.3)
    assert hidden.colour[hidden.present][:, 2].max() < 1e-9
    # Reflection keeps the texture's contrast, which diffusion would lose.
    assert hidden.colour[hidden.present][:, 1].std() > 0.5 * scene().colour[~BLOCK][:, 1].std()


def test_a_scene_without_edges_hides_nothing():
    flat = Layer(FLOOR, scene().colour, np.ones(SHAPE, dtype=bool))
    hidden = hidden_layer(flat, 1.0, 0.5)
    assert not hidden.present.any()
    assert np.array_equal(hidden.disparity, FLOOR)


def test_nearly_touching_blocks_do_not_lend_their_colour_to_the_floor_between():
    front = scene()
    front.disparity[:, 62:66], front.colour[:, 62:66] = 30.0, (0.0, 0.0, 1.0)
    hidden = hidden_layer(clean_rims(front, 1.0), 1.0, 0.3)
    behind_post = hidden.present & (COLUMNS >= 62) & (COLUMNS < 66)
    assert behind_post.any()
    assert np.isfinite(hidden.disparity).all()
    assert hidden.disparity[behind_post].max() < 29


def test_rims_on_the_far_side_take_the_clean_colour_beyond():
    front = scene()
    smeared = front.colour.copy()
    smeared[16:45, 60:62] = (0.0, 0.0, 0.5)  # two pixels of mixture on the background, right of the block
    cleaned = clean_rims(Layer(front.disparity, smeared, front.present), 1.0)
    assert cleaned.colour[20:40, 60:62, 2].max() == 0
    assert np.array_equal(cleaned.colour[BLOCK], front.colour[BLOCK])
    assert np.array_equal(cleaned.colour[:, 60 + RIM_PX :], front.colour[:, 60 + RIM_PX :])


def test_pixels_that_hang_between_two_surfaces_are_taken_for_unmeasured():
    row = np.array([[57.0, 57.0, 50.0, 24.0, 21.0, 21.0, np.inf, 21.0]])
    kept = without_flying_pixels(np.repeat(row, 3, axis=0), jump=1.0)
    assert np.isnan(kept[0]).tolist() == [False, False, True, True, False, False, True, False]


def test_slopes_and_edges_without_anything_between_are_kept():
    values = np.where(COLUMNS < 40, FLOOR, FLOOR + 20)
    assert np.array_equal(without_flying_pixels(values, jump=1.0), values)


def test_holes_beside_the_block_are_filled_with_the_background():
    front = scene()
    holed = front.disparity.copy()
    holed[:, 14:21] = np.nan  # what the second camera does not see, left of the block
    filled = fill_holes(holed, front.colour, 1.0)
    assert np.abs(filled - FLOOR)[:, 14:21].max() < 1.5
    assert np.array_equal(filled[:, 21:], front.disparity[:, 21:])


def test_a_hole_in_the_rim_of_the_block_is_filled_with_the_block_that_it_looks_like():
    front = scene()
    holed = front.disparity.copy()
    holed[20:40, 58:60] = np.nan
    assert (fill_holes(holed, front.colour, 1.0)[20:40, 58:60] == 40).all()


def test_a_cross_of_holes_through_the_whole_map_is_filled():
    holed = FLOOR.copy()
    holed[28:33], holed[:, 38:43] = np.nan, np.inf
    filled = fill_holes(holed, scene().colour, 1.0)
    assert np.abs(filled - FLOOR).max() < 1.5


def test_a_single_measured_pixel_fills_the_map():
    holed = np.full(SHAPE, np.nan)
    holed[7, 9] = 3.0
    assert (fill_holes(holed, scene().colour, 1.0) == 3.0).all()


def test_a_map_without_measurements_is_refused():
    with pytest.raises(InputError, match="no finite value"):
        fill_holes(np.full(SHAPE, np.inf), scene().colour, 1.0)
