"""`python -m tests.mutants [FILE ...]`: whether the tests of every commit find a hundred small faults in ten files.

A mutant differs from a file in one operator, comparison or number; ten are taken from each file, evenly spaced. The
test files that import the file's module are run, without what runs by night, until a test fails. What none finds is
tried again with the tests of the night: if these find it, leaving them to the night has lost it.

Sources are changed in place and put back, also after Ctrl-C. Each trial is a fork of one process that has loaded the
libraries, so that a trial takes little more than its tests.
"""

import argparse
import ast
import importlib
import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path

import pytest

from tests.quick import ROOT, imports_one, module_of

FILES = (
    "calibration/gs2ci_calibration/dark_flat.py",
    "calibration/gs2ci_calibration/geometry/axes.py",
    "drivers/gs2ci_drivers/dlpc900/erle.py",
    "gs2ci/evaluate/cameras.py",
    "gs2ci/reconstruct/decode/patches/within_time.py",
    "gs2ci/reconstruct/fit/scene/smear.py",
    "gs2ci/reconstruct/geometry/sources/wide.py",
    "gs2ci/reconstruct/registration/proposals.py",
    "gs2ci/reconstruct/registration/sharpen.py",
    "sims/gs2ci_sims/effects/views.py",
)
EACH = 10
LIBRARIES = ("numpy", "scipy.ndimage", "scipy.stats", "cv2", "torch", "numba", "hypothesis", "h5py", "skimage", "tyro")
_LOADED = "ignore::pytest.PytestAssertRewriteWarning"  # plugins were there before pytest
# A mutant that never ends is found.
LONGEST_S = 600
_SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


def mutants(source: str) -> list[tuple[int, str, str]]:
    """Return the changes of a source that are tried: the line, what it says, and the whole source as it then is."""
    places = [node for node in ast.walk(ast.parse(source)) if _changed(node) is not None]
    places.sort(key=lambda node: (node.lineno, node.col_offset))
    taken = [places[number * len(places) // EACH] for number in range(EACH)] if len(places) >= EACH else places
    return [(node.lineno, *_applied(source, node)) for node in taken]


def _changed(node: ast.AST) -> ast.expr | None:
    """Return what takes the place of an expression, None if it stays."""
    if (
        isinstance(node, ast.BinOp)
        and type(node.op) in _SWAPPED
        and not isinstance(node.left, ast.Constant | ast.JoinedStr)
    ):
        return ast.BinOp(node.left, _SWAPPED[type(node.op)](), node.right)
    if isinstance(node, ast.Compare) and type(node.ops[0]) in _SWAPPED:
        return ast.Compare(node.left, [_SWAPPED[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    if isinstance(node, ast.BoolOp):
        return ast.BoolOp(_SWAPPED[type(node.op)](), node.values)
    if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in (0, 1):
        return ast.Constant(node.value * 2)
    return None


def _applied(source: str, node: ast.AST) -> tuple[str, str]:
    lines = source.encode().splitlines(keepends=True)  # columns count bytes
    begin = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    old, new = source.encode(), ast.unparse(_changed(node))
    return f"{old[begin:end].decode()} -> {new}", (old[:begin] + f"({new})".encode() + old[end:]).decode()


def tests_of(file: str) -> list[str]:
    """Return the test files that import a file's module, the one that mirrors it first."""
    module, stem = module_of(file), Path(file).stem
    found = [path for path in sorted((ROOT / "tests").rglob("test_*.py")) if imports_one(path, {module})]
    return [str(path) for path in sorted(found, key=lambda path: path.name != f"test_{stem}.py")]


def fails(tests: Sequence[str], *more: str) -> bool:
    """Tell whether one of the tests fails, in a process of its own."""
    child = os.fork()
    if child == 0:
        signal.alarm(LONGEST_S)
        status = 1
        with suppress(BaseException), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            status = int(
                pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-W", _LOADED, *more, *tests])
            )
        os._exit(status)
    return os.waitpid(child, 0)[1] != 0


def tried(file: str) -> Iterator[tuple[str, str]]:
    """Try the mutants of a file; yields what changed, and whether it is "found", "lost" or found by "nobody"."""
    path, tests = ROOT / file, tests_of(file)
    source = path.read_text(encoding="utf-8")
    if fails(tests):
        raise SystemExit(f"tests of {file} fail as it is")
    for line, change, mutant in mutants(source):
        try:
            path.write_text(mutant, encoding="utf-8")
            answer = "found" if fails(tests) else "lost" if fails(tests, "--nightly") else "nobody"
        finally:
            path.write_text(source, encoding="utf-8")
        yield f"{file}:{line}  {change}", answer


def main(arguments: Sequence[str]) -> int:
    """Try the files that are named, or all; returns how many mutants the tests of a commit have lost to the night."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants")
    parser.add_argument("files", nargs="*", default=FILES)
    # Kept byte code counts as that of any source of the same second and size.
    sys.dont_write_bytecode = True
    for name in LIBRARIES:
        importlib.import_module(name)
    answers = []
    for file in parser.parse_args(arguments).files:
        for what, answer in tried(file):
            print(f"{answer:>6}  {what}", flush=True)
            answers.append(answer)
    told = ", ".join(f"{answers.count(one)} {one}" for one in ("found", "lost", "nobody"))
    print(f"{len(answers)} mutants: {told}")
    return answers.count("lost")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
