"""The files of what real devices do: complete, each row with a test that exists, and in the wheel."""

import re
from itertools import groupby
from pathlib import Path

import pytest

from gs2ci_drivers.manners import KEYS, MannersError, kinds, manners_for, manners_of, read_manners
from gs2ci_drivers.plugin import BUILT_IN

ROOT = Path(__file__).parents[2]
ALL = [(kind, one) for kind in kinds() for one in manners_of(kind)]
ENTRY = "\n".join(["[[manner]]", *(f'{key} = "x"' for key in KEYS)])


# Families of firmware that one driver serves, with what a device of each says of itself.
FAMILIES = {"fluidnc": "Grbl 3.9 [FluidNC v3.9.1]", "grblhal": "GrblHAL 1.1f"}


def test_there_are_files_and_each_is_of_a_kind_that_a_rig_file_can_name_or_of_a_family():
    known = {kind for group in BUILT_IN.values() for kind in group}
    assert {"alp", "kinesis"} <= set(kinds())
    assert set(kinds()) - known == FAMILIES.keys()
    assert manners_of("lamp-array") == ()
    assert manners_of("scpi") == ()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_told_of_a_device_that_names_itself_after_it(family):
    assert manners_for("grbl", FAMILIES[family]) == (*manners_of("grbl"), *manners_of(family))
    assert manners_for("grbl", "GRBL 1.1h") == manners_of("grbl")
    assert manners_for("kinesis", "Thorlabs KDC101 1.2.3 for Zaber") == manners_of("kinesis")  # a kind is no family


def test_each_id_is_there_once():
    ids = [one.id for _, one in ALL]
    assert len(ids) == len(set(ids))
    assert all(one.id.startswith(f"{kind}-") for kind, one in ALL)


def test_each_row_names_a_test_that_exists():
    for path, rows in groupby(sorted(one.test for _, one in ALL), key=lambda test: test.partition("::")[0]):
        defined = set(re.findall(r"^ *def (test_\w+)", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE))
        assert {re.split(r"::|\[", row)[1] for row in rows} <= defined, path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[manner]", "is not TOML"),
        ("", "holds nothing"),
        (ENTRY + "\n[other]", "holds manner, other"),
        ("manner = 3", "holds manner"),
        ("manner = [3]", "lacks applies"),
        (ENTRY.replace("guess", "guesses"), "lacks guess; has guesses"),
        (ENTRY.replace('fact = "x"', "fact = 3"), "fact of 'x' is no text"),
        (ENTRY.replace('fact = "x"', 'fact = " "'), "fact of 'x' is no text"),
        (ENTRY + "\n" + ENTRY, "the id 'x' stands twice"),
    ],
)
def test_a_file_that_cannot_be_is_refused(tmp_path, text, said):
    file = tmp_path / "odd.toml"
    file.write_text(text)
    with pytest.raises(MannersError, match=said):
        read_manners(file)


def test_a_file_that_is_no_text_is_refused(tmp_path):
    file = tmp_path / "odd.toml"
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(MannersError, match="is not TOML"):
        read_manners(file)
