"""How figures are written for people: counts, numbers, nested settings as rows.

Not here: which figures are shown.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

THIN_SPACE: Final = "\u2009"
UNKNOWN: Final = "–"
# Endings of names in this project, and how their units are written after a number.
UNITS: Final = {
    "s": " s",
    "mm": " mm",
    "px": " px",
    "deg": "°",
    "dn": " DN",
    "e": " e⁻",
    "mib": " MiB",
    "hz": " Hz",
    "c": " °C",
}


def describe_number(value: float | None, digits: int = 4) -> str:
    """Write a number with `digits` significant digits, and spaces between thousands; a dash if it is not known.

    >>> describe_number(0.0123456), describe_number(48200), describe_number(None)
    ('0.01235', '48\u2009200', '–')
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if float(value).is_integer() and abs(value) < 1e15:
        return f"{int(value):,}".replace(",", THIN_SPACE)
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:,.0f}".replace(",", THIN_SPACE)
    return f"{value:.{digits}g}"


def told_apart(values: Sequence[float], write: Callable[[float, int], str]) -> list[str]:
    """Write the numbers of a scale with two significant digits, or with more, up to five, if they would look equal.

    >>> told_apart([0, 0.1234, 0.5], describe_number), told_apart([0.984, 0.976], describe_number)
    (['0', '0.12', '0.5'], ['0.984', '0.976'])
    """
    for digits in range(2, 6):
        texts = [write(float(f"{value:.{digits}g}"), digits) for value in values]
        if len(set(texts)) == len(texts):
            break
    return texts


def describe_value(value: Any) -> str:
    """Write any plain value of a report: yes, no, a number, a short list, a text."""
    match value:
        case None:
            return UNKNOWN
        case bool():
            return "yes" if value else "no"
        case int() | float():
            return describe_number(value)
        case list() | tuple():
            # Items that are sentences contain commas of their own.
            mark = "; " if any(isinstance(item, str) and " " in item for item in value) else ", "
            return mark.join(describe_value(item) for item in value)
        case _:
            return str(value)


def flat_rows(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """List nested values as rows of (dotted name, text); lists of plain values stay on one row."""
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flat_rows(value, f"{name}.")
        elif isinstance(value, Sequence) and not isinstance(value, str) and any(_is_nested(item) for item in value):
            yield from flat_rows({str(index): item for index, item in enumerate(value)}, f"{name}.")
        else:
            yield name, describe_value(value)


def spoken_rows(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """List nested values as `flat_rows` does, with names in words, and a name's final unit written after the number.

    >>> list(spoken_rows({"exposure_s": 0.16, "mask_index": 3}))
    [('exposure', '0.16 s'), ('mask index', '3')]
    """
    for name, text in flat_rows(values):
        stem, _, ending = name.rpartition("_")
        unit = UNITS.get(ending, "") if stem and text[-1:].isdigit() else ""
        yield (stem if unit else name).replace("_", " "), text + unit


def _is_nested(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, Sequence) and not isinstance(value, str))
