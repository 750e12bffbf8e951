"""The conflict about the count of 0x1A31, and how counting pulses settles it."""

import pytest

from gs2ci.core.errors import InputError
from gs2ci_drivers.dlpc900.firmware import PROFILES, profile


def test_revision_j_counts_masks_and_revision_f_repeats() -> None:
    assert profile("rev-j").count(8, 3) == 24
    assert profile("rev-f").count(8, 3) == 3
    assert {one.count(8, 0) for one in PROFILES.values()} == {0}


@pytest.mark.parametrize(
    ("name", "counted", "says"),
    [
        ("rev-j", 3, ""),
        ("rev-j", 24, "rev-f"),
        ("rev-f", 3, ""),
        ("rev-j", 2, "cable"),
        ("rev-f", 2, "cable"),
    ],
)
def test_a_wrong_number_of_pulses_names_the_profile_to_use(name: str, counted: int, says: str) -> None:
    sentence = profile(name).explain_pulses(entries=8, repeats=3, pulses_per_round=1, counted=counted)
    assert says in sentence
    assert bool(sentence) == bool(says)


def test_a_firmware_that_counts_masks_under_the_other_profile_is_recognised() -> None:
    assert "rev-j" in profile("rev-f").explain_pulses(entries=8, repeats=8, pulses_per_round=1, counted=1)


def test_an_unknown_profile_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="rev-f, rev-j"):
        profile("rev-z")
