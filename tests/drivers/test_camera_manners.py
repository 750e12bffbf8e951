"""The manners of cameras and of the DLPC900: whole, told apart, and each with a test that exists."""

import re
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

KEYS = {"id", "applies", "guess", "fact", "source", "test"}
ROOT = Path(__file__).parents[2]


def manners(name):
    text = (files("gs2ci_drivers") / "manners" / f"{name}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)["manner"]


@pytest.mark.parametrize("name", ["v4l2", "genicam", "dlpc900"])
def test_each_has_its_source_and_a_test_that_exists(name):
    found = manners(name)
    assert len({one["id"] for one in found}) == len(found)
    for one in found:
        assert set(one) == KEYS
        assert all(isinstance(value, str) and value for value in one.values())
        assert one["id"].startswith(f"{name}-")
        path, test = one["test"].split("::")
        assert re.search(rf"^def {test}\(", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE), one["test"]
