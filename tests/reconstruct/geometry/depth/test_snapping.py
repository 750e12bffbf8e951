"""Jumps of depth at the edges of the view."""

import numba
import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth import snapping
from gs2ci.reconstruct.geometry.depth.snapping import snapped
from gs2ci.render import places


def test_jumps_of_depth_move_to_the_edges_of_the_view():
    view = np.full((40, 60, 3), 0.2, np.float32)
    view[:, 30:] = 0.8
    wide = np.full((40, 60), 0.3, np.float32)
    wide[:, 26:] = 0.9
    found = snapped(wide, view)
    assert (found[10:-10, :30] < 0.6).all()
    assert (found[10:-10, 30:] > 0.6).all()
    slope = np.tile(np.linspace(0.3, 0.9, 60, dtype=np.float32), (40, 1))
    assert np.abs(snapped(slope, np.full((40, 60, 1), 0.5, np.float32)) - slope).max() < 0.11
    flat = np.full((4, 5), 0.4, np.float32)
    assert np.array_equal(snapped(flat, view[:4, :5]), flat)


def by_definition(inverse_depth, view):
    """Return the weighted median of levels in float64, by sorting; NaN where rounding may decide."""
    low, high = inverse_depth.min(), inverse_depth.max()
    levels = np.rint((inverse_depth - low) / (high - low) * 255).astype(int)
    found = inverse_depth.astype(np.float64)
    for r, c in np.ndindex(levels.shape):
        window = np.s_[max(r - 10, 0) : r + 11, max(c - 10, 0) : c + 11]
        weights = np.exp(-((view[window].astype(np.float64) - view[r, c]) ** 2).sum(axis=2) / (2 * 0.04**2))
        sums = np.bincount(levels[window].ravel(), weights.ravel(), minlength=256)
        reached = np.cumsum(sums) / sums.sum()
        median = int(np.argmax(reached >= 0.5))
        if np.abs(reached - 0.5).min() < 1e-4:
            found[r, c] = np.nan
        elif abs(median - levels[r, c]) > 2:
            same = levels[window] == median
            found[r, c] = np.average(inverse_depth[window][same], weights=weights[same])
    return found


@pytest.fixture(params=[False, True], ids=["host", "device"])
def somewhere(request, monkeypatch):
    """Let the filter run on the host, or on a device for which the host stands in, a few windows at once."""
    monkeypatch.setattr(snapping, "AT_ONCE", 50_000)
    places.count_host_as_device(yes=request.param)
    yield
    places.count_host_as_device(yes=False)


@pytest.mark.parametrize(("size", "channels"), [((13, 150), 3), ((30, 7), 1), ((1, 40), 3), ((40, 1), 1)])
def test_both_forms_do_what_the_definition_says(size, channels, somewhere):
    rng = np.random.default_rng(size[1])
    view = rng.random((*size, channels), dtype=np.float32) * np.float32(0.2)
    # Two surfaces with a little noise, a sloping part, and pixels by themselves.
    depth = np.where(np.add.outer(np.arange(size[0]), np.arange(size[1])) % 29 < 14, 0.3, 0.8)
    depth = (depth + 1e-3 * np.arange(size[1]) + rng.normal(0, 0.01, size)).astype(np.float32)
    wanted = by_definition(depth, view)
    sure = np.isfinite(wanted)
    assert sure.mean() > 0.9
    assert (np.abs(wanted - depth)[sure] > 0.05).any()
    np.testing.assert_allclose(snapped(depth, view)[sure], wanted[sure], rtol=1e-5)


def test_a_map_does_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(3)
    view, depth = rng.random((20, 30, 3), dtype=np.float32), rng.random((20, 30), dtype=np.float32)
    before = numba.get_num_threads()
    try:
        found = []
        for threads in sorted({1, before}):
            numba.set_num_threads(threads)
            found.append(snapped(depth, view))
    finally:
        numba.set_num_threads(before)
    assert all(np.array_equal(one, found[0]) for one in found)
