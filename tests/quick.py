"""`python -m tests.quick [REVISION]`: the tests of what has changed since a revision, by default the last commit.

A changed module is tested by the files that import it, among them the one that mirrors it; a changed test by itself.
What is marked slow or nightly is left to `make test` and `make nightly`.
"""

import ast
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOTS = ("", "drivers/", "calibration/", "sims/")


def changed(revision: str) -> list[str]:
    """Return the files that differ from a revision, new ones included, relative to the repository."""
    commands = (["diff", "--name-only", "--diff-filter=d", revision], ["ls-files", "--others", "--exclude-standard"])
    listed = (subprocess.run(["git", *one], cwd=ROOT, capture_output=True, text=True, check=True) for one in commands)
    return sorted({name for one in listed for name in one.stdout.splitlines()})


def module_of(name: str) -> str:
    """Return the module that a file holds, "" if none that is shipped."""
    if not name.endswith(".py") or name.startswith("tests/"):
        return ""
    for root in ROOTS[1:]:
        name = name.removeprefix(root)
    module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    return module if module.startswith("gs2ci") else ""


def imported(path: Path) -> set[str]:
    """Return the modules that a file imports, and those of which it imports names."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
        elif isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
    return found


def imports_one(path: Path, modules: set[str]) -> bool:
    """Tell whether a file imports one of these modules; to read it as a program takes long, so its words come first."""
    text = path.read_text(encoding="utf-8")
    return any(module.rpartition(".")[2] in text for module in modules) and not modules.isdisjoint(imported(path))


def chosen(names: Iterable[str]) -> list[Path]:
    """Return the test files that concern these files."""
    names = list(names)
    modules = {module for module in map(module_of, names) if module}
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    own = {ROOT / name for name in names if Path(name).name.startswith("test_")}
    about_pages = any(name.endswith(".md") for name in names)
    return [
        path
        for path in files
        if path in own or (about_pages and path == ROOT / "tests" / "test_docs.py") or imports_one(path, modules)
    ]


def main(arguments: list[str]) -> int:
    """Run them; returns pytest's status, 0 if nothing that is tested has changed."""
    files = chosen(changed(arguments[0] if arguments else "HEAD"))
    if not files:
        print("Nothing has changed that a test is about.")
        return 0
    print(f"{len(files)} files of tests are about what has changed.")
    return int(pytest.main(["-q", "-m", "not slow and not nightly", *map(str, files)]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
