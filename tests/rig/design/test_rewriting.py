import tomllib

import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.design.rewriting import with_capture

TEXT = """# A bench.
name = "a # b"

[capture]             # what is taken
masks = 8             # as many as fit
density=0.25
"mask_s" = 0.02
# the way
axis = "x"

# what is known
[optics]
masks = "not these"
"""


def test_numbers_are_set_where_they_stand_and_comments_stay():
    made = with_capture(TEXT, {"masks": 16, "mask_s": 0.01})
    assert made == TEXT.replace("masks = 8 ", "masks = 16 ").replace("0.02", "0.01")


def test_new_keys_follow_the_last_one_of_the_table():
    made = with_capture(TEXT, {"element": 2, "shots": 1})
    assert 'axis = "x"\nelement = 2\nshots = 1\n\n# what is known\n[optics]' in made


def test_a_file_without_a_capture_gets_one():
    assert with_capture('name = "a"', {"masks": 4}) == 'name = "a"\n\n[capture]\nmasks = 4\n'


def test_a_last_line_without_its_end_and_windows_line_ends_are_kept():
    assert with_capture("[capture]\nmasks = 8", {"density": 0.5}) == "[capture]\nmasks = 8\ndensity = 0.5\n"
    assert with_capture("[capture]\r\nmasks = 8\r\n", {"masks": 4, "shots": 1}) == (
        "[capture]\r\nmasks = 4\r\nshots = 1\r\n"
    )


def test_nothing_to_change_changes_nothing():
    assert with_capture(TEXT, {}) == TEXT


@pytest.mark.parametrize(
    "text", ["capture = { masks = 8 }\n", "capture.masks = 8\n", '[capture]\naxis = """\nmasks = 8\n"""\n']
)
def test_a_capture_that_is_not_written_line_by_line_is_refused(text):
    tomllib.loads(text)
    with pytest.raises(InputError, match="cannot be changed where it is written"):
        with_capture(text, {"masks": 16})
