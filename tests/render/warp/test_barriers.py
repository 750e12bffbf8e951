"""Where a block's threads wait for each other, all of them come by: on CUDA a thread that does not leaves the others
waiting, or paired with a later wait. The CPU's fibers do not mind."""

import ast
import inspect
import textwrap

import pytest

pytest.importorskip("warp", reason="Warp is not installed")

from tests.benchmarks.gpu_kernels import launched_by_blocks

REDUCED = ("tile_sum", "tile_max", "tile_min")


def waits_under_conditions(function) -> list[str]:
    """Return what waits for a whole block, or reads a tile's sum, in the body of an `if`."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    reduced = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and called(node.value) in REDUCED
        for target in node.targets
    }
    found = []
    for branch in (node for node in ast.walk(tree) if isinstance(node, ast.If)):
        for statement in (*branch.body, *branch.orelse):
            for node in ast.walk(statement):
                waits = called(node).startswith("tile") or called(node) == "sum_of_block"
                reads = isinstance(node, ast.Subscript) and getattr(node.value, "id", "") in reduced
                if waits or (reads and not in_condition(node, statement)):
                    found.append(ast.unparse(node))
    return found


def in_condition(node, statement) -> bool:
    return isinstance(statement, ast.If) and node in ast.walk(statement.test)


def called(node) -> str:
    if not isinstance(node, ast.Call):
        return ""
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


@pytest.mark.parametrize("kernel", [kernel for kernel, _ in launched_by_blocks()], ids=lambda kernel: kernel.key)
def test_all_threads_of_a_block_come_by_where_they_wait(kernel):
    assert waits_under_conditions(kernel.func) == []


def test_a_wait_of_some_threads_is_found():
    def kernel(total, lane, out, wp):
        both = wp.tile_sum(wp.tile(total))
        if lane == 0:
            out[0] = both[0]

    assert waits_under_conditions(kernel) == ["both[0]"]
