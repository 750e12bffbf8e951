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
    """Return what waits for a whole block, or reads a tile's sum, in the body of an `if` or of a thread's own loop.

    Where an entry of a tile is written, all threads wait too (warp 1.19).
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    reduced = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and called(node.value) in REDUCED
        for target in node.targets
    }
    tiles = {
        target.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and called(node.value) == "tile_zeros"
        for target in node.targets
    }
    found = []
    for branch in (node for node in ast.walk(tree) if isinstance(node, ast.If) or is_of_a_thread(node)):
        for statement in (*branch.body, *branch.orelse):
            for node in ast.walk(statement):
                waits = called(node).startswith("tile") or called(node) == "sum_of_block"
                reads = isinstance(node, ast.Subscript) and getattr(node.value, "id", "") in reduced
                writes = isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
                writes = writes and getattr(node.value, "id", "") in tiles
                if waits or writes or (reads and not in_condition(node, statement)):
                    found.append(ast.unparse(node))
    return found


def is_of_a_thread(node) -> bool:
    """Tell whether a node is a loop that each thread begins at its own number."""
    return isinstance(node, ast.For) and any(getattr(name, "id", "") == "lane" for name in ast.walk(node.iter))


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


def test_an_entry_of_a_tile_is_not_written_by_some_threads_alone():
    def kernel(wp, lane, some, shape):
        tile = wp.tile_zeros(shape)
        tile[0, lane] = 1.0
        if some:
            tile[1, lane] = 1.0
        for k in range(lane, 36):
            tile[k, 0] = 1.0

    assert waits_under_conditions(kernel) == ["tile[1, lane]", "tile[k, 0]"]
