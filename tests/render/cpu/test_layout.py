import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci.render.cpu.layout import lay_out, strip_rows_for
from gs2ci.render.simd.vector import LANES


def masks_of(seed, views, height, width, share):
    rng = np.random.default_rng(seed)
    values = rng.uniform(0.1, 1, (views, height, width)).astype(np.float32)
    return values * (rng.random((views, height, width)) < share)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    views=st.integers(1, 3),
    height=st.integers(1, 21),
    width=st.integers(1, 21),
    share=st.sampled_from([0.0, 0.05, 0.4, 1.0]),
    rows=st.sampled_from([None, 1, 3, 8]),
)
def test_each_open_pixel_lies_in_one_lane_of_its_view_with_its_mask_value(seed, views, height, width, share, rows):
    masks = masks_of(seed, views, height, width, share)
    layout = lay_out(masks, rows)
    seen = np.zeros_like(masks)
    for view in range(views):
        lanes = slice(layout.cell_start[view] * LANES, layout.cell_start[view + 1] * LANES)
        pixels, weights = layout.pixel[lanes], layout.weight[lanes]
        np.add.at(seen[view].reshape(-1), pixels, weights)
        np.testing.assert_array_equal(layout.x[lanes], pixels % width + 0.5)
        np.testing.assert_array_equal(layout.y[lanes], pixels // width + 0.5)
        assert (layout.cell_view[layout.cell_start[view] : layout.cell_start[view + 1]] == view).all()
    np.testing.assert_array_equal(seen, masks)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.05, 0.4, 1.0]), rows=st.sampled_from([2, 5]))
def test_cells_between_the_tables_entries_hold_all_pixels_of_an_interval(seed, share, rows):
    masks = masks_of(seed, 2, 11, 17, share)
    layout = lay_out(masks, rows)
    left, right = sorted(np.random.default_rng(seed).integers(0, 17, 2))
    for view in range(2):
        for strip in range(layout.strips):
            first, last = layout.first[view, strip, left], layout.last[view, strip, right]
            start = layout.cell_start[view]
            lanes = np.arange((start + first) * LANES, max((start + last + 1), start + first) * LANES)
            inside = lanes[layout.weight[lanes] > 0]
            band = masks[view, strip * rows : (strip + 1) * rows, left : right + 1]
            columns = layout.pixel[inside] % 17
            rows_of = layout.pixel[inside] // 17
            within = (columns >= left) & (columns <= right) & (rows_of // rows == strip)
            assert within.sum() == (band > 0).sum()


def test_spare_lanes_repeat_a_pixel_without_weight():
    layout = lay_out(np.ones((1, 3, 7), np.float32), 3)
    assert layout.cells == 2
    assert (layout.weight[21:] == 0).all()
    assert (layout.pixel[21:] == layout.pixel[20]).all()


@pytest.mark.parametrize(("share", "rows"), [(1.0, 4), (0.25, 8), (1e-9, 32), (0.06, 16)])
def test_strip_height_follows_the_open_share(share, rows):
    assert strip_rows_for(share) == rows


def test_masks_that_are_all_closed_have_no_cells():
    layout = lay_out(np.zeros((2, 5, 6), np.float32))
    assert layout.cells == 0
    assert layout.pixel.size == layout.cell_view.size == 0
