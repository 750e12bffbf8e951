"""Text files of numbers, as spreadsheets, numpy.savetxt, ImageJ and loggers write them: rows, and names of columns.

Separated by commas, semicolons, tabs or blanks; with decimal commas where the columns are not separated by commas; in
UTF-8, UTF-16 or Latin-1. Not here: what the columns mean (`stage_log`, `camera`).
"""

import codecs
import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ArrayEntry, Container, check_bytes, damage_as_input_error

# A number can begin with these; a file of another beginning is no table without names.
_BEGINNINGS: Final = frozenset(b'0123456789+-.#,;"')
# Where columns are counted from; poses have at most so many numbers a row, of which the first may count, too.
_FROM: Final = (0, 1)
_MOST_IN_A_POSE: Final = 16
_UTF16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


@dataclass(frozen=True)
class Table:
    """Rows of numbers, and the names of their columns, which may be none."""

    names: list[str]
    columns: F64


def is_numbers(start: bytes) -> bool:
    """Tell whether a file that begins so may be a text of numbers."""
    text = start.removeprefix(codecs.BOM_UTF8).lstrip()
    return text[:1] != b"" and text[0] in _BEGINNINGS and b"\0" not in text


def read_text(path: Path) -> Container:
    """Open a text of numbers without names as one array: a row of text is a row of it.

    Raises:
        InputError: It is none.
    """
    stored_bytes = path.stat().st_size
    check_bytes(str(path), (stored_bytes,), 1, stored_bytes, 1)
    columns, note = _without_labels(table(path, "rows of as many numbers each, without names"))
    values = columns[:, 0] if columns.shape[1] == 1 else columns
    return Container(path, {"": ArrayEntry(values.shape, "number")}, lambda _: values, note)


def _without_labels(read: Table) -> tuple[F64, str]:
    """Leave out what only numbers rows and columns, as pandas and R write them; and say so."""
    rows, columns = read.columns.shape
    if len(read.names) > 1 and not read.names[0].strip():
        return read.columns[:, 1:], "names of columns, and a first column without one, which names rows: left out"
    if (
        rows > 1
        and columns > _MOST_IN_A_POSE
        and any((read.columns[0] == np.arange(k, columns + k)).all() for k in _FROM)
    ):
        return read.columns[1:], "a first row that counts the columns: left out"
    return read.columns, ""


def table(path: Path, allowed: str) -> Table:
    """Read a text file of numbers; a line that begins with # is a remark, and the first one may hold names.

    Args:
        path: The file.
        allowed: For messages: what such a file looks like.

    Raises:
        InputError: No such file, no rows, or a row that is none of numbers like the others.
    """
    with damage_as_input_error(str(path)):
        if not path.is_file():
            raise InputError(f"{path}: no such file", remedy="check the name")
        stored = [line for line in _decoded(path.read_bytes()).splitlines() if line.strip()]
        lines = [line.strip() for line in stored]
    names, unmarked = [], [line for line in lines if not line.startswith("#")]
    if not unmarked:
        raise InputError(f"{path}: no rows", allowed=allowed)
    mark = next((one for one in ";\t" if one in unmarked[0]), "," if "," in unmarked[0] else None)
    rows = [_split(line, mark) for line in unmarked]
    # A tab before the names stands for the column of rows' names, which has none.
    lacks_one = len(rows) > 1 and len(rows[0]) == len(rows[1]) - 1 and stored[0].lstrip(" ").startswith("\t")
    if _numbers(rows[0], mark) is None or lacks_one:
        names, rows = [""] * lacks_one + [name.strip() for name in rows[0]], rows[1:]
    elif lines[0].startswith("#"):  # as numpy.savetxt writes a header
        said = next(csv.reader([lines[0].lstrip("# ")], delimiter=mark or " "))
        names = said if len(said) == len(rows[0]) else []
    values = [_numbers(row, mark) for row in rows]
    for number, row in enumerate(values, 1):
        if row is None or len(row) != len(values[0] or ()):
            raise InputError(f"{path}: row {number} is no row of numbers like the others", allowed=allowed)
    if not values:
        raise InputError(f"{path}: names, and no rows", allowed=allowed)
    columns = np.array(values, np.float64)
    if names and len(names) != columns.shape[1]:
        raise InputError(f"{path}: {len(names)} names for {columns.shape[1]} columns", allowed=allowed)
    return Table(names, columns)


def _decoded(stored: bytes) -> str:
    """Return a text; Latin-1 is what spreadsheets write where it is no UTF-8, and reads every byte."""
    if stored.startswith(_UTF16):
        return stored.decode("utf-16")
    try:
        return stored.decode("utf-8-sig")
    except UnicodeDecodeError:
        return stored.decode("latin-1")


def _split(line: str, mark: str | None) -> list[str]:
    fields = line.split() if mark is None else next(csv.reader([line], delimiter=mark))
    # Some programs end each row with a separator.
    return fields[:-1] if len(fields) > 1 and not fields[-1].strip() else fields


def _numbers(row: Sequence[str], mark: str | None) -> list[float] | None:
    try:  # decimal commas, as spreadsheets write them beside semicolons and tabs
        return [float(one if mark == "," else one.replace(",", ".")) for one in row]
    except ValueError:
        return None
