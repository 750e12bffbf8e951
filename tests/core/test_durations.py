import pytest

from gs2ci.core.durations import parse_duration_s, spoken_duration
from gs2ci.core.errors import InputError


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("60s", 60), ("60", 60), ("2min", 120), ("2 MIN", 120), ("1.5h", 5400), (".5m", 30), ("9 sec", 9), (1.5, 1.5)],
)
def test_durations_are_read_as_people_write_them(text, seconds):
    assert parse_duration_s(text) == seconds


@pytest.mark.parametrize(
    "text",
    ["", "s", "-3s", "0s", "3 days", "1e3s", "nan", "inf", "1min 30s", "9" * 400, -3, 0.0, True, None],
)
def test_what_is_no_duration_is_refused(text):
    with pytest.raises(InputError, match="no duration"):
        parse_duration_s(text)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (9.94, "9.9 s"),
        (42.4, "42 s"),
        (119.4, "119 s"),
        (200, "3 min 20 s"),
        (7199.7, "2 h 00 min"),
        (7500, "2 h 05 min"),
    ],
)
def test_durations_are_said_with_the_digits_that_matter(seconds, text):
    assert spoken_duration(seconds) == text
