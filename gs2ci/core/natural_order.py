"""Names in the order of the numbers in them: mask10 after mask9, z_-4mm before z_3mm.

Here: which minus is a sign, and where whole and decimal numbers order names differently. Not here: reading files.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final

_NUMBER: Final = re.compile(r"(\d+(?:\.\d+)?)")
_WHOLE: Final = re.compile(r"(\d+)")
# A minus after one of these, or at the beginning, joins nothing, so that it is a sign; after a letter or a digit it may
# be a hyphen.
_APART: Final = "_=([{,;:+@ /\\"
_UNIT: Final = re.compile(r"(?:nm|um|µm|μm|mm|cm|m|deg|rad|ms|us|s|px|V|mV|K|C)(?![A-Za-z])")


@dataclass(frozen=True)
class NameOrder:
    """An order of names.

    Args:
        indices: Of the names, in that order.
        is_doubtful: Whether whole numbers decided, 0.5 before 0.25, where decimal ones would give another order.
    """

    indices: tuple[int, ...]
    is_doubtful: bool


def natural_order(names: Sequence[str]) -> NameOrder:
    """NameOrder names by their numbers, from left to right.

    A minus before a number is a sign if nothing stands before it that it could join to the number, or if other names
    have their number there without it. Names with a sign, and numbers before a unit, are decimal; others whole.

    Args:
        names: File names, or paths with "/".
    """
    signed = _signed(names)
    has_units = any(
        "." in match.group() and _UNIT.match(name, match.end())
        for name in map(_stem, names)
        for match in _NUMBER.finditer(name)
    )
    decimal = _sorted(names, _NUMBER, signed)
    if has_units or any(signed):
        return NameOrder(decimal, is_doubtful=False)
    whole = _sorted(names, _WHOLE, signed)
    return NameOrder(whole, is_doubtful=whole != decimal)


def _stem(name: str) -> str:
    """Return a path without its ending, which may hold a digit of its own (jp2)."""
    path = PurePosixPath(name)
    return name[: len(name) - len(path.suffix)] if path.suffix and not path.suffix[1:].isdigit() else name


def _signed(names: Sequence[str]) -> list[set[int]]:
    """Return for each name the starts of the numbers before which a minus is a sign."""
    stems = [_stem(name) for name in names]
    # What stands before a number, numbers themselves apart, in any of the names.
    before = {_NUMBER.sub("#", stem[: match.start()]) for stem in stems for match in _NUMBER.finditer(stem)}
    found: list[set[int]] = []
    for stem in stems:
        starts = set()
        for match in _NUMBER.finditer(stem):
            head = stem[: match.start()]
            if head[-1:] not in ("-", "−"):
                continue
            rest = head[:-1]
            joins = rest and rest[-1] not in _APART
            if not joins or (_NUMBER.sub("#", rest) in before and not rest[-1:].isdigit()):
                starts.add(match.start())
        found.append(starts)
    return found


def _sorted(names: Sequence[str], numbers: re.Pattern[str], signed: list[set[int]]) -> tuple[int, ...]:
    def key(index: int) -> list[Any]:
        stem, parts, at = _stem(names[index]), [], 0
        for match in numbers.finditer(stem):
            negative = match.start() in signed[index]
            parts += [(0.0, stem[at : match.start() - negative]), (-1 if negative else 1) * float(match.group())]
            at = match.end()
        # Numbers and texts alternate, so that they are never compared with each other.
        return [part if isinstance(part, tuple) else (part, "") for part in [*parts, (0.0, stem[at:])]]

    return tuple(sorted(range(len(names)), key=key))
