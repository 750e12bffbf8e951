"""Every mechanism can be left out, and says what it does."""

import re
from pathlib import Path

import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.mechanisms import MECHANISMS, mechanism
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings

DECISIONS = Path(__file__).parents[2] / "docs" / "decisions"
NAMES = [one.name for one in MECHANISMS]


def test_a_switch_changes_the_settings_into_others_that_make_sense():
    for one in MECHANISMS:
        left = one.without(Settings())
        assert left != Settings(), one
        left.check()
        assert one.without(left) == left or one.name in set(LeftOut), one


def test_a_mechanism_has_a_sentence_and_the_record_that_let_it_in():
    told = [one for one in MECHANISMS if len(one.what.split()) > 3 and (DECISIONS / f"{one.decision}.md").is_file()]
    assert told == list(MECHANISMS)


def test_what_has_no_setting_of_its_own_is_a_mechanism():
    assert len(set(NAMES)) == len(NAMES)
    assert set(LeftOut) <= set(NAMES)


def test_switches_of_surfaces_leave_settings_without_surfaces_alone():
    for name in ("depth field", "margin"):
        assert mechanism(name).without(preset("paper")).fit.surfaces is None


def test_an_unknown_mechanism_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="second fit"):
        mechanism("luck")


def test_every_part_that_can_be_left_out_is_asked_for_somewhere():
    """A switch that nothing reads would measure chance."""
    sources = "".join(path.read_text() for path in (DECISIONS.parents[1] / "gs2ci" / "reconstruct").rglob("*.py"))
    assert [one.name for one in LeftOut if not re.search(rf"LeftOut\.{one.name} (not )?in ", sources)] == []
