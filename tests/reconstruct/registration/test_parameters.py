"""The one list of the masks' errors: complete, in the order of the record, with steps that displace what they say."""

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.parameters import BY_NAME, GROUPS, NAMES, PARAMETERS, in_words, let_in

SIZE = (96, 128)


def test_the_list_has_every_error_of_the_record_in_its_order():
    assert list(NAMES) == [one.name for one in fields(Misfit)]
    assert [one for group in GROUPS for one in group.parameters] == list(PARAMETERS)


@pytest.mark.parametrize("one", [one for one in PARAMETERS if one.per_px is not None], ids=lambda one: one.name)
def test_a_step_displaces_the_farthest_corner_by_a_tenth_of_a_pixel(one):
    step = one.step_at(float(np.hypot(*SIZE)) / 2, 1.0)
    moved = Misfit(**{one.name: step}).displacement_px(SIZE)
    # A term that grows along one direction alone moves the corner by less than one that grows outwards.
    assert 0.03 <= np.linalg.norm(moved, axis=1).max() <= 0.101


def test_steps_of_the_black_level_are_shares_of_the_mean_reading():
    assert BY_NAME["black"].step_at(80.0, 20.0) == pytest.approx(0.2)
    assert BY_NAME["leak"].step_at(80.0, 20.0) == pytest.approx(0.01)


def test_something_is_said_of_what_was_let_in_alone_and_of_a_field_once():
    misfit = Misfit(down_px=0.5, radial_px=0.3, down_dd_px=0.1, leak=0.03)
    errors = {"down_px": 0.01, "right_px": 0.01, "radial_px": 0.02, "down_dd_px": 0.02}
    said = in_words(misfit.values(), errors)
    assert said.count("bent by a smooth field") == 1
    assert "+0.500 ± 0.010 px down" in said
    assert "of the light" not in said


def test_what_ended_at_a_limit_of_its_range_is_not_let_in_nor_is_its_group():
    pairs = {"down_px": (0.5, 0.01), "right_px": (0.0, 0.01), "rotation_deg": (0.3, 0.01)}
    at_limits = pairs | {"scale": (BY_NAME["scale"].limits[1], 1e-4), "leak": (BY_NAME["leak"].limits[0], 1e-3)}
    assert let_in(at_limits, 80.0, 1.0) == ("down_px", "right_px")
    within = pairs | {"scale": (0.05, 1e-4), "leak": (-0.19, 1e-3)}
    assert let_in(within, 80.0, 1.0) == tuple(within)


def test_what_is_uncertain_or_too_small_to_matter_is_not_let_in():
    pairs = {"down_px": (0.015, 1e-4), "right_px": (0.04, 0.01), "leak": (0.02, 0.006), "black": (0.02, 1e-3)}
    assert let_in(pairs, 80.0, 1.0) == ("black",)
    assert let_in(pairs, 80.0, 3.0) == ()


def test_a_bench_reads_the_list_without_numba_or_torch():
    code = (
        "import sys, gs2ci.reconstruct.registration.parameters\n"
        "assert not {'numba', 'torch', 'scipy'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
