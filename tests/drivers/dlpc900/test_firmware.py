"""The conflict about the count of 0x1A31."""

import pytest

from gs2ci.core.errors import InputError
from gs2ci_drivers.dlpc900.firmware import PROFILES, profile


def test_revision_j_counts_masks_and_revision_f_repeats() -> None:
    assert profile("rev-j").count(8, 3) == 24
    assert profile("rev-f").count(8, 3) == 3
    assert {one.count(8, 0) for one in PROFILES.values()} == {0}


def test_an_unknown_profile_is_refused_with_those_there_are() -> None:
    with pytest.raises(InputError, match="rev-f, rev-j"):
        profile("rev-z")
