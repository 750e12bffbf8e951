"""One name, one thing."""

import ast
from collections import defaultdict
from pathlib import Path

import gs2ci

# The base of all tables of a rig file, and the settings of a reconstruction; what `gs2ci doctor` looked at, and what a
# reconstruction found.
STATED = {"Settings", "Finding"}


def test_no_public_class_of_the_package_shares_its_name_with_another():
    defined = defaultdict(list)
    for path in sorted(Path(gs2ci.__file__).parent.rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                defined[node.name].append(path.name)
    twice = {name: files for name, files in defined.items() if len(files) > 1}
    assert set(twice) <= STATED, twice
