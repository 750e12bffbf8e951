"""The conflict about the count of 0x1A31."""

from gs2ci_drivers.dlpc900.firmware import PROFILES


def test_revision_j_counts_masks_and_revision_f_repeats() -> None:
    assert PROFILES["rev-j"].count(8, 3) == 24
    assert PROFILES["rev-f"].count(8, 3) == 3
    assert {one.count(8, 0) for one in PROFILES.values()} == {0}
