"""How large the reconstruction is: tokens of code, and plain numbers among the constants of its modules; neither grows.

python -m tests.reconstruct.test_size    prints both, by folder
"""

import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

R = Path(__file__).parents[2] / "gs2ci" / "reconstruct"
CODE = (tokenize.NAME, tokenize.OP, tokenize.NUMBER)
# What there is now; a change that needs more takes it from elsewhere, or says in its commit why it is worth it.
MOST_TOKENS = 201_150
MOST_CONSTANTS = 434


def tokens(source):
    """Count names, operators and numbers: what lines of another length do not change."""
    return sum(token.type in CODE for token in tokenize.generate_tokens(io.StringIO(source).readline))


def constants(source):
    """Count constants at module level that are a number, or made of numbers alone."""
    found = (node.value for node in ast.parse(source).body if isinstance(node, ast.Assign | ast.AnnAssign))
    return sum(is_number(value) for value in found if value is not None)


def is_number(node):
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)


def by_folder():
    """Return tokens and constants of each folder, and of the modules beside them."""
    many, numbers = Counter(), Counter()
    for path in sorted(R.rglob("*.py")):
        source, folder = path.read_text(encoding="utf-8"), path.relative_to(R).parts[0].removesuffix(".py")
        many[folder] += tokens(source)
        numbers[folder] += constants(source)
    return many, numbers


def test_a_constant_is_a_number_and_what_is_counted_is_code():
    source = '"""Words."""\nA = 1  # one\nB: Final = -2 * 3.0\nC = "4"\nD = True\nE = A\ndef f():\n    g = 5\n'
    assert constants(source) == 2
    assert tokens("a = 1  # one\n") == tokens("a = (\n1)\n") - 2 == 3


def test_the_reconstruction_has_no_more_code_than_it_had():
    assert by_folder()[0].total() <= MOST_TOKENS


def test_it_has_no_more_numbers_at_module_level_than_it_had():
    assert by_folder()[1].total() <= MOST_CONSTANTS


if __name__ == "__main__":
    many, numbers = by_folder()
    for folder, count in [("in all", many.total()), *many.most_common()]:
        print(f"{count:8,} tokens  {numbers[folder] if folder != 'in all' else numbers.total():4} constants  {folder}")
