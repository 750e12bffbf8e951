import math
from pathlib import Path

import numpy as np
import pytest

from gs2ci.api.options import MOST_COUNT, MOST_SEED, as_path, check_kind, check_number, check_seed, check_whole, every
from gs2ci.core.errors import InputError


@pytest.mark.parametrize("value", [None, 1, MOST_COUNT])
def test_a_count_within_bounds_and_an_option_left_out_are_accepted(value):
    check_whole("--fits", value, 1)


@pytest.mark.parametrize("value", [0, -5, 10**30, True, 2.0, "2"])
def test_a_count_out_of_bounds_is_refused_with_option_range_and_remedy(value):
    with pytest.raises(InputError) as caught:
        check_whole("--fits", value, 1, 64)
    assert caught.value.problem == f"--fits {value}"
    assert caught.value.allowed == "a whole number from 1 to 64"
    assert caught.value.remedy == "give such a number, or leave --fits out"


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "allowed"),
    [
        ({}, (-1e300, 0, 1e300), (math.nan, math.inf, -math.inf), "a finite number"),
        ({"above": 0}, (1e-300, 7), (0, -1, math.nan, math.inf), "a finite number above 0"),
        ({"least": 0}, (0, 7), (-1e-9, math.inf), "a finite number from 0"),
        ({"most": 5}, (-7, 5), (5.1, -math.inf), "a finite number up to 5"),
        ({"least": 0, "most": 1}, (0, 1), (2, math.nan), "a finite number from 0 to 1"),
        ({"above": 0, "most": 1}, (0.5, 1), (0, 2), "a finite number above 0 to 1"),
    ],
)
def test_numbers_are_held_to_their_bounds(bounds, good, bad, allowed):
    for value in (None, *good):
        check_number("--x", value, **bounds)
    for value in bad:
        with pytest.raises(InputError) as caught:
            check_number("--x", value, **bounds)
        assert (caught.value.problem, caught.value.allowed) == (f"--x {value:g}", allowed)


def test_a_remedy_of_the_options_own_is_said_instead():
    for check in (check_whole, check_number):
        with pytest.raises(InputError, match="what to do: ask somebody"):
            check("--x", -1, 0, remedy="ask somebody")


def test_seeds_are_what_generators_take():
    check_seed(0)
    check_seed(MOST_SEED)
    for seed in (-1, MOST_SEED + 1):
        with pytest.raises(InputError, match="--seed"):
            check_seed(seed)


def test_values_are_of_the_kinds_that_an_option_has():
    check_kind("--geometry", "rest", str, "a text")
    check_kind("--geometry", None, (str, type(None)), "a text")
    for other in (3, None, ["rest"], np.eye(4)):
        with pytest.raises(InputError) as caught:
            check_kind("--geometry", other, str, "a text", remedy="ask somebody")
        assert caught.value.problem == f"--geometry is {type(other).__name__}"
        assert (caught.value.allowed, caught.value.remedy) == ("a text", "ask somebody")


def test_a_single_text_is_one_of_several():
    assert every("mask_s=1..2") == ("mask_s=1..2",)
    assert every(["a", "b"]) == ("a", "b")


def test_paths_are_texts_or_paths():
    assert as_path("a/b", of="a file", remedy="") == as_path(Path("a/b"), of="a file", remedy="") == Path("a/b")
    for other in (None, 3, b"a", ["a"]):
        with pytest.raises(InputError) as caught:
            as_path(other, of="a run folder", remedy="ask somebody")
        assert caught.value.problem == f"{type(other).__name__} where a path is expected"
        assert (caught.value.allowed, caught.value.remedy) == ("the path of a run folder", "ask somebody")
