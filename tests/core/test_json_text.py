import pytest

from gs2ci.core.json_text import parse_json


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
