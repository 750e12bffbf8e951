"""Options that two functions share, declared and described by only one of them.

A command, or a function over many shots, takes the arguments of the function behind it. Here: `with_options_of`, which
adds them to its signature and its docstring, for `help`, for the parser of the command line and for completion;
`argument_texts`. Not here: any option.
"""

import functools
import inspect
import re
import textwrap
from collections.abc import Callable, Container
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])
_ARGUMENTS = re.compile(r"\n\nArgs:((?:\n+ .*)*)")
_REST = re.compile(r"\n\n(?=Returns:|Raises:|Example:)")


def with_options_of(function: Callable[..., Any], *, without: tuple[str, ...] = ()) -> Callable[[_Function], _Function]:
    """Give a function that ends in `**options` the arguments of another one, with their types, defaults and texts.

    An argument that the taker declares itself keeps its own type and default, and its own text if it has one, so that
    only differences need to be written.

    Args:
        function: The function whose arguments are taken, each as a keyword argument.
        without: Names of arguments that are not taken.
    """

    def decorate(taker: _Function) -> _Function:
        own, lent = inspect.signature(taker).parameters, inspect.signature(function).parameters
        keyword_only = inspect.Parameter.KEYWORD_ONLY
        taken = [
            own.get(name, parameter.replace(kind=keyword_only))
            for name, parameter in lent.items()
            if name not in without
        ]
        kept = [one for one in own.values() if one not in taken and one.kind is not one.VAR_KEYWORD]
        # Positional arguments, required ones, those of both functions, those of the taker alone.
        places = list(own)
        whole = sorted([*taken, *kept], key=lambda one: _rank(one, lent, places))
        signature = inspect.signature(taker).replace(parameters=whole)

        @functools.wraps(taker)
        def given_all(*arguments: Any, **named: Any) -> Any:
            bound = signature.bind(*arguments, **named)
            bound.apply_defaults()
            return taker(*bound.args, **bound.kwargs)

        del given_all.__wrapped__  # otherwise the parser would see the function without the taken arguments
        given_all.__signature__ = signature  # type: ignore[attr-defined]
        given_all.__annotations__ = {one.name: one.annotation for one in whole}
        given_all.__annotations__["return"] = signature.return_annotation
        texts = {**argument_texts(function), **argument_texts(taker)}
        told = "\n".join(_filled(f"    {one.name}: {texts[one.name]}") for one in whole if one.name in texts)
        about, *rest = _REST.split(_ARGUMENTS.sub("", inspect.cleandoc(taker.__doc__ or "")))
        given_all.__doc__ = "\n\n".join([about, f"Args:\n{told}", *rest]) + "\n"
        return cast("_Function", given_all)

    return decorate


def _rank(parameter: inspect.Parameter, lent: Container[str], places: list[str]) -> tuple[int, int]:
    if parameter.kind is not parameter.KEYWORD_ONLY:
        return parameter.kind, places.index(parameter.name)
    return parameter.kind, 0 if parameter.default is parameter.empty else 1 if parameter.name in lent else 2


def _filled(text: str) -> str:
    return textwrap.fill(text, 110, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False)


def argument_texts(function: Callable[..., Any]) -> dict[str, str]:
    """Return the text of each argument in a docstring, as one line each."""
    section = _ARGUMENTS.search(inspect.cleandoc(function.__doc__ or ""))
    found = re.findall(r"^    (\w+): (.*(?:\n {5,}.*)*)", section[1], re.MULTILINE) if section else []
    return {name: " ".join(text.split()) for name, text in found}
