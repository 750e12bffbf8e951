"""Jumps of depth at the edges of the view."""

import numpy as np

from gs2ci.reconstruct.geometry.snapping import snapped


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
