"""Checks of numeric options, words and paths, with the same error messages for every command.

Here: checks made before anything is loaded, opened or computed. Not here: the effect of an option; nor bounds that
depend on a file or a device.
"""

import math
import os
from collections.abc import Sequence
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Final

from gs2ci.core.errors import InputError

# More than any use needs, and small enough for every counter: a larger value is a typing error.
MOST_COUNT: Final = 1_000_000
# Generators accept no larger one.
MOST_SEED: Final = 2**63 - 1


def check_whole(option: str, value: int | None, least: int, most: int = MOST_COUNT, *, remedy: str = "") -> None:
    """Accept a whole number within bounds, or an option that was left out.

    Args:
        option: As it is typed, with its dashes.
        value: What was typed after it; None for nothing.
        least: The smallest that is allowed.
        most: The largest.
        remedy: What else the user can do; leaving the option out, if nothing is said.

    Raises:
        InputError: It is out of bounds.
    """
    given: Any = value  # in Python it may be of any kind
    if value is not None and not (_is_whole(given) and least <= value <= most):
        raise InputError(
            f"{option} {value}", allowed=f"a whole number from {least} to {most}", remedy=remedy or _left_out(option)
        )


def check_number(
    option: str,
    value: float | None,
    least: float = -math.inf,
    most: float = math.inf,
    *,
    above: float | None = None,
    remedy: str = "",
) -> None:
    """Accept a finite number within bounds, or an option that was left out.

    Args:
        option: As it is typed, with its dashes.
        value: What was typed after it; None for nothing.
        least: The smallest that is allowed.
        most: The largest.
        above: What it has to exceed, where the bound itself is not allowed.
        remedy: What else the user can do; leaving the option out, if nothing is said.

    Raises:
        InputError: It is out of bounds or not finite.
    """
    if value is None:
        return
    given: Any = value  # in Python it may be of any kind
    finite = isinstance(given, Real) and math.isfinite(given)
    if finite and least <= value <= most and (above is None or value > above):
        return
    bounds = [f"above {above:g}"] if above is not None else [f"from {least:g}"] if math.isfinite(least) else []
    bounds += [f"to {most:g}" if bounds else f"up to {most:g}"] if math.isfinite(most) else []
    allowed = " ".join(["a finite number", *bounds])
    shown = f"{value:g}" if isinstance(given, Real) else repr(value)
    raise InputError(f"{option} {shown}", allowed=allowed, remedy=remedy or _left_out(option))


def check_kind(option: str, value: object, kinds: type | tuple[type, ...], allowed: str, *, remedy: str = "") -> None:
    """Accept a value of some kinds. At a command line the parser has done so already.

    Args:
        option: As it is typed, with its dashes.
        value: What was given in Python.
        kinds: Types that are accepted.
        allowed: The same in words.
        remedy: What else the user can do.

    Raises:
        InputError: It is of another kind.
    """
    if not isinstance(value, kinds):
        raise InputError(f"{option} is {type(value).__name__}", allowed=allowed, remedy=remedy)


def check_choice(option: str, value: str | None, allowed: Sequence[str | None]) -> None:
    """Accept one of several words. At a command line the parser has done so already.

    Raises:
        InputError: It is none of them.
    """
    if value not in allowed:
        raise InputError(f"{option} {value}", allowed=", ".join(word for word in allowed if word is not None))


def check_seed(seed: int) -> None:
    """Accept a seed.

    Raises:
        InputError: No generator takes it.
    """
    check_whole("--seed", seed, 0, MOST_SEED)


def every(texts: str | Sequence[str]) -> tuple[str, ...]:
    """Return texts as a tuple; a single one is not taken for its letters."""
    return (texts,) if isinstance(texts, str) else tuple(texts)


def as_path(path: str | os.PathLike[str], *, of: str, remedy: str) -> Path:
    """Return a path as a Path.

    Args:
        path: What was given.
        of: What it should be the path of.
        remedy: What to do with something else.

    Raises:
        InputError: It is something else.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"{type(path).__name__} where a path is expected", allowed=f"the path of {of}", remedy=remedy)
    return Path(path)


def _is_whole(value: object) -> bool:
    """Tell whether a value counts something: true and false do not, though Python takes them for 1 and 0."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def _left_out(option: str) -> str:
    return f"give such a number, or leave {option} out"
