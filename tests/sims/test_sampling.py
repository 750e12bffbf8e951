"""Panels of time end where the motion jumps, once for each jump."""

import numpy as np
import pytest

from gs2ci_sims.sampling import cut_at

EDGES = np.linspace(0.0, 8.0, 9)


def test_a_jump_well_within_a_panel_ends_it():
    assert cut_at(np.array([2.5, 6.3]), EDGES) == pytest.approx([0, 1, 2, 2.5, 3, 4, 5, 6, 6.3, 7, 8])


def test_a_jump_near_the_end_of_a_panel_or_outside_is_passed_over():
    assert np.array_equal(cut_at(np.array([-1.0, 2.99, 5.0, 5.01, 9.0]), EDGES), EDGES)


def test_jumps_close_together_make_no_panel_between_them():
    """A stage that turns takes up its play within a microsecond."""
    jumps = np.array([6.3, 2.5 + 1e-6, 2.5, 2.515, 2.53])
    assert cut_at(jumps, EDGES) == pytest.approx([0, 1, 2, 2.5, 2.53, 3, 4, 5, 6, 6.3, 7, 8], abs=1e-9)
    assert np.diff(cut_at(jumps, EDGES)).min() > 0.02


def test_no_jump_leaves_panels_as_they_are():
    assert np.array_equal(cut_at(np.zeros(0), EDGES), EDGES)
