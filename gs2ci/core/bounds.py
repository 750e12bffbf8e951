"""Bounds of settings that are dataclasses: declared beside each field, and checked by one method.

Here: the base class. Not here: the kinds of numbers with names, and settings that come from files (`config`).
"""

from dataclasses import fields
from functools import cache
from typing import Annotated, Any, Literal, Self, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from gs2ci.core.errors import InputError

LARGEST_WINDOW_PX = 255
"""Side of a window over which pictures are compared: several times the largest useful one."""


def odd(number: int) -> int:
    """Return an odd number as it is, for `pydantic.AfterValidator`.

    Raises:
        ValueError: It is even.
    """
    if number % 2 == 0:
        raise ValueError("an odd number")
    return number


class Bounded:
    """Base of a dataclass whose fields have the bounds of their types: `Annotated[int, Field(ge=1)]`, `Literal[...]`.

    Settings whose fields depend on each other extend `check`.
    """

    def check(self) -> Self:
        """Return self if every field is within its bounds, and so are the settings among the fields.

        Raises:
            InputError: One is not; names the field and its value.
        """
        settings: type = type(self)
        for name, bounds in _bounds(settings).items():
            value = getattr(self, name)
            for part in value if isinstance(value, tuple) else (value,):
                if isinstance(part, Bounded):
                    part.check()
            try:
                bounds.validate_python(value)
            except ValidationError as error:
                allowed = error.errors()[0]["msg"].removeprefix("Input should be ").removeprefix("Value error, ")
                raise InputError(f"{name} = {value!r} in {settings.__name__}", allowed=allowed) from error
        return self


class BoundedRecord(Bounded):
    """The same, for records that are checked as they are made: none exists out of its bounds."""

    def __post_init__(self) -> None:
        self.check()


@cache
def _bounds(settings: type) -> dict[str, TypeAdapter[Any]]:
    """Return what checks each field of a class; a field without bounds may hold anything."""
    hints = get_type_hints(settings, include_extras=True)
    names = [field.name for field in fields(settings)]
    return {name: TypeAdapter(hints[name] if _has_bounds(hints[name]) else Any) for name in names}


def _has_bounds(hint: Any) -> bool:
    return get_origin(hint) in (Annotated, Literal) or any(_has_bounds(part) for part in get_args(hint))
