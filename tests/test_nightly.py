"""What a commit leaves to the night: the list names tests that exist, and the right cases are left out."""

import ast
import re
from pathlib import Path

import pytest

from tests.nightly import by_night, listed

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("path", sorted({test.partition("::")[0] for test in listed()}))
def test_every_test_of_the_list_exists(path):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    there = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    named = {re.split(r"::|\[", test)[1] for test in listed() if test.startswith(f"{path}::")}
    assert named <= there


def test_the_first_cases_are_kept_and_single_cases_and_whole_tests_are_left_out():
    keep = {"a.py::few": 2, "a.py::one[x: × 2]": 0, "a.py::none": 0}
    names = ["a.py::few[1]", "a.py::few[2]", "a.py::few[3]", r"a.py::one[x: \xd7 2]", "a.py::one[y]", "a.py::none"]
    assert by_night(names, keep) == [False, False, True, True, False, True]
    assert by_night(["a.py::few[3]", "b.py::none"], keep) == [False, False]


def test_what_runs_instead_is_there():
    text = (ROOT / "tests" / "nightly.toml").read_text(encoding="utf-8")
    for line in re.findall(r'^instead = "(.*)"', text, re.MULTILINE):
        for name in re.findall(r"tests/[\w./]*\w", line):
            assert (ROOT / name).exists(), name
