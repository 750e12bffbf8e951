"""Options that are said once: what a function takes over from the one behind it."""

import importlib
import inspect

import pytest

from gs2ci.api.derived import argument_texts, with_options_of
from gs2ci.cli import COMMANDS
from gs2ci.commands.completion import options_of


def lender(path: str, size: int = 3, *, name: str | None = None, seed: int = 42, heard: object = None) -> str:
    """Do it.

    Args:
        path: Where.
        size: How large: in px,
            along the longer side.
        name: Of what.
        seed: Of every draw.
        heard: Who hears.

    Returns:
        It.
    """
    return f"{path} {size} {name} {seed}"


@with_options_of(lender, without=("path", "heard"))
def taker(file: str, *, overwrite: bool = False, out: str, name: int | None = None, **options: object) -> tuple:
    """Take it.

    Longer.

    Args:
        file: Which.
        out: Whither.
        overwrite: Replace.

    Returns:
        All.

    Raises:
        ValueError: Never.
    """
    return file, overwrite, out, name, options


def test_what_is_required_comes_first_then_what_both_take_then_what_the_taker_adds():
    signature = inspect.signature(taker)
    assert list(signature.parameters) == ["file", "out", "size", "name", "seed", "overwrite"]
    assert signature.parameters["size"].default == 3
    assert signature.parameters["size"].kind is inspect.Parameter.KEYWORD_ONLY
    assert taker.__annotations__["seed"] is int
    assert taker.__annotations__["return"] is tuple


def test_a_declaration_of_ones_own_holds_and_the_text_comes_from_whoever_has_one():
    assert inspect.signature(taker).parameters["name"].annotation == (int | None)
    told = argument_texts(taker)
    assert told["name"] == "Of what."
    assert told["size"] == "How large: in px, along the longer side."
    assert told["file"] == "Which."
    assert "heard" not in told
    about, arguments, *rest = taker.__doc__.split("\n\nArgs:\n")[0], *taker.__doc__.split("\n\nArgs:\n")[1:]
    assert about == "Take it.\n\nLonger."
    assert not rest
    assert arguments.endswith("Returns:\n    All.\n\nRaises:\n    ValueError: Never.\n")


def test_a_call_gets_every_option_and_refuses_others():
    assert taker("a", out="b", seed=7) == ("a", False, "b", None, {"size": 3, "seed": 7})
    with pytest.raises(TypeError, match="heard"):
        taker("a", out="b", heard=1)
    with pytest.raises(TypeError, match="out"):
        taker("a")


def test_every_option_of_every_command_has_a_text():
    runs = {command: importlib.import_module(module).run for command, (module, _) in COMMANDS.items()}
    assert [(command, one.names) for command, run in runs.items() for one in options_of(run) if not one.help] == []
