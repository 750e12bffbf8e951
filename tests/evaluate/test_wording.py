import math

import pytest

from gs2ci.evaluate.wording import describe_number, describe_value, flat_rows, spoken_rows, told_apart


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0123456, "0.01235"),
        (48200, "48\u2009200"),
        (123456.7, "123\u2009457"),
        (-3, "-3"),
        (2.0, "2"),
        (1e-9, "1e-09"),
        (None, "–"),
        (math.nan, "–"),
        (math.inf, "–"),
    ],
)
def test_numbers_are_short_and_their_thousands_apart(value, text):
    assert describe_number(value) == text


def test_no_two_numbers_of_a_scale_read_alike_unless_they_are():
    assert told_apart([1.0, 0.984, 0.976], describe_number) == ["1", "0.984", "0.976"]
    assert told_apart([0.1234, 0.5], describe_number) == ["0.12", "0.5"]
    assert told_apart([0.3, 0.3], describe_number) == ["0.3", "0.3"]
    assert told_apart([123456.0, 120001.0], describe_number) == ["123\u2009000", "120\u2009000"]


def test_values_of_every_kind_are_text():
    assert describe_value(True) == "yes"
    assert describe_value(False) == "no"
    assert describe_value(None) == "–"
    assert describe_value([1, 2.5, "x"]) == "1, 2.5, x"
    assert describe_value(["a sentence, of words", "b"]) == "a sentence, of words; b"
    assert describe_value("text") == "text"


def test_nested_values_are_rows_with_dotted_names():
    nested = {"a": {"b": 1, "c": [1, 2]}, "d": [{"e": True}, {"e": False}], "f": [[1, 2], [3]], "g": {}}
    assert list(flat_rows(nested)) == [
        ("a.b", "1"),
        ("a.c", "1, 2"),
        ("d.0.e", "yes"),
        ("d.1.e", "no"),
        ("f.0", "1, 2"),
        ("f.1", "3"),
    ]


def test_a_unit_that_ends_a_name_is_written_after_the_number():
    values = {"exposure_s": 0.16, "memory_mib": 24105, "stage": {"from_mm": [0, 2.5], "turn_deg": -3}}
    assert list(spoken_rows(values)) == [
        ("exposure", "0.16 s"),
        ("memory", "24\u2009105 MiB"),
        ("stage.from", "0, 2.5 mm"),
        ("stage.turn", "-3°"),
    ]


def test_what_only_looks_like_a_unit_stays_in_the_name():
    values = {"mode_s": "per-exposure", "s": 1, "usable_cores": 4, "seen_px": None}
    assert list(spoken_rows(values)) == [
        ("mode s", "per-exposure"),
        ("s", "1"),
        ("usable cores", "4"),
        ("seen px", "–"),
    ]
