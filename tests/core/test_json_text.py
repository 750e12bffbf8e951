import json
from dataclasses import dataclass

import numpy as np
import pytest

from gs2ci.core.json_text import as_json, parse_json, plain_json


def test_values_come_back_as_they_are():
    assert parse_json('{"a": [1, 2.5, null, "x"]}') == {"a": [1, 2.5, None, "x"]}


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1,]", "[" * 100_000, '{"a":' * 100_000, "9" * 10_000],
    ids=["empty", "open", "comma", "deep list", "deep object", "endless number"],
)
def test_whatever_is_wrong_is_one_kind_of_error(text):
    with pytest.raises(ValueError):  # noqa: PT011  the kind is what is promised
        parse_json(text)


def test_a_value_is_reduced_to_what_json_can_hold():
    @dataclass
    class Preset:
        steps: int
        rates: tuple[float, ...]

    value = {1: Preset(3, (0.5, float("nan"))), "array": np.arange(2), "flag": np.bool_(True), "none": None}
    plain = {"1": {"steps": 3, "rates": [0.5, None]}, "array": [0, 1], "flag": True, "none": None}
    assert plain_json(value) == plain
    assert json.loads(as_json(value)) == plain
