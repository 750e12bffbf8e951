"""Where a file's first paragraph says that only certain others import it, nobody else does."""

import ast
import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"gs2ci": ROOT, "gs2ci_drivers": ROOT / "drivers", "gs2ci_calibration": ROOT / "calibration"}
PACKAGES |= {"gs2ci_sims": ROOT / "sims"}
# "Only `a`, `b` and tests import this file": names in backticks and the tests, nothing in other words.
STATEMENT = re.compile(r"Only ((?:`[^`]+`|tests|, | and )+) imports? this (?:file|package)")


def modules() -> dict[str, ast.Module]:
    found = {}
    for package, folder in PACKAGES.items():
        for path in (folder / package).rglob("*.py"):
            name = ".".join(path.relative_to(folder).with_suffix("").parts).removesuffix(".__init__")
            found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def imported_by(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Return who imports each module, by name."""
    importers = defaultdict(set)
    for name, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                for imported in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names)):
                    importers[imported].add(name)
    return importers


def is_named(importer: str, name: str, package: str) -> bool:
    """Tell whether a name in a statement is that of an importer: in full, as a neighbour, or as a command."""
    if name.startswith("gs2ci "):
        return importer.removesuffix("_") == f"gs2ci.commands.{name.split()[1]}"
    known = (name, f"{package}.{name.removesuffix('.py')}")
    return any(importer == one or importer.startswith(f"{one}.") for one in known)


def test_who_alone_may_import_a_file_alone_does():
    trees = modules()
    importers, told = imported_by(trees), 0
    for module, tree in trees.items():
        statement = STATEMENT.search(" ".join((ast.get_docstring(tree) or "").split()))
        if statement is None:
            continue
        told += 1
        names, package = re.findall(r"`([^`]+)`", statement[1]), module.rpartition(".")[0]
        others = [one for one in importers[module] if not any(is_named(one, name, package) for name in names)]
        assert not others, f"{module} says «{statement[0]}», and {', '.join(others)} import it too"
    assert told > 60
