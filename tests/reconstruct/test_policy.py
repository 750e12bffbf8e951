"""What steers a reconstruction: enumerations and figures; no string stands for a type, no message is read, no object is
recognised by being the same."""

import ast
import re
from functools import cache
from pathlib import Path

R = Path(__file__).parents[2] / "gs2ci" / "reconstruct"
POLICY = (
    *sorted((R / "hypotheses").glob("*.py")),
    *(R / f"{name}.py" for name in ("pipeline", "observe", "first_look", "fusion", "record", "settings")),
    *(R / "geometry" / f"{name}.py" for name in ("choose", "initialise", "reversal", "prior")),
    *(R / "geometry" / f"{name}.py" for name in ("sources/sources", "sources/direct", "path/validity")),
    *(R / "fit" / "coarse" / f"{name}.py" for name in ("stage", "stopping", "pace")),
    *(R / "fit" / "combining" / f"{name}.py" for name in ("ensemble", "combination")),
    R / "presets" / "budget.py",
)
TYPES = {"source", "verdict", "decoder", "origin", "state", "outcome", "kind"}


@cache
def comparisons(path):
    return [
        (node.lineno, op, node.left, other)
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Compare)
        for op, other in zip(node.ops, node.comparators, strict=True)
    ]


def attribute(node):
    return node.attr if isinstance(node, ast.Attribute) else None


def test_no_string_is_a_type():
    strings = (ast.Constant, ast.Tuple, ast.Set, ast.List)
    found = [
        f"{path.name}:{line}"
        for path in POLICY
        for line, _, left, right in comparisons(path)
        for one, other in ((left, right), (right, left))
        if attribute(one) in TYPES
        and isinstance(other, strings)
        and any(isinstance(part, ast.Constant) and isinstance(part.value, str) for part in ast.walk(other))
    ]
    assert found == []


def test_no_message_is_read():
    found = [
        (path.name, line) for path in POLICY for line, _, *sides in comparisons(path) if "code" in map(attribute, sides)
    ]
    assert found == []


def test_no_object_is_recognised_by_being_the_same():
    found = [path.name for path in POLICY if re.search(r"\bid\(", path.read_text())] + [
        f"{path.name}:{line}"
        for path in POLICY
        for line, op, _, other in comparisons(path)
        if isinstance(op, ast.Is | ast.IsNot) and not isinstance(other, ast.Constant)
    ]
    assert found == []


def test_the_whole_reconstruction_is_one_page():
    assert len((R / "pipeline.py").read_text().splitlines()) <= 120
