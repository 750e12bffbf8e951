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

ENDINGS: Final = (".csv", ".txt", ".tsv", ".log", ".dat")
# A number can begin with these; a file of another beginning is no table without names.
_BEGINNINGS: Final = frozenset(b'0123456789+-.#,;"')
# Where columns are counted from; poses have at most so many numbers a row, of which the first may count, too.
_FROM: Final = (0, 1)
_MOST_IN_A_POSE: Final = 16
_UTF16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


@dataclass(frozen=True)
class Table:
    """Rows of numbers, NaN in columns of text, and the names of the columns, which may be none.

    Args:
        names: By column.
        columns: [R, C].
        is_headed: The names are the first row, and no remark.
    """

    names: list[str]
    columns: F64
    is_headed: bool


def is_numbers(start: bytes, ending: str) -> bool:
    """Tell whether a file that begins so may be a text of numbers; one of such an ending may begin with names."""
    text = start.removeprefix(codecs.BOM_UTF8).lstrip()
    return text[:1] != b"" and (text[0] in _BEGINNINGS or ending.lower() in ENDINGS) and b"\0" not in text


def read_text(path: Path) -> Container:
    """Open a text of numbers without names as one array: a row of text is a row of it.

    Raises:
        InputError: It is none.
    """
    stored_bytes = path.stat().st_size
    check_bytes(str(path), (stored_bytes,), 1, stored_bytes, 1)
    columns, note = _without_labels(path, table(path, "rows of as many numbers each, without names"))
    values = columns[:, 0] if columns.shape[1] == 1 else columns
    return Container(path, {"": ArrayEntry(values.shape, "number")}, lambda _: values, note)


def _without_labels(path: Path, read: Table) -> tuple[F64, str]:
    """Leave out what only numbers rows and columns, as data frames are written; and say so.

    Raises:
        InputError: A few columns with names: what they hold is not asked for here.
    """
    columns, left_out = read.columns, []
    texts = np.array([bool(read.names) and bool(np.isnan(column).all()) for column in columns.T])
    if texts.any():
        columns, left_out = columns[:, ~texts], ["columns of text"]
    if len(read.names) > 1 and not read.names[0].strip() and not texts[0]:
        columns, left_out = columns[:, 1:], [*left_out, "names of columns, and a first column without one"]
    if columns.shape[1] > _MOST_IN_A_POSE:
        for axis, told in ((0, "a first row that counts the columns"), (1, "a first column that counts the rows")):
            first: F64 = columns[:, 0] if axis else columns[0]
            if len(columns) > 1 and any((first == np.arange(k, len(first) + k)).all() for k in _FROM):
                columns, left_out = np.delete(columns, 0, axis=axis), [*left_out, told]
    elif read.is_headed and not left_out:
        raise InputError(
            f"{path}: columns named {', '.join(read.names)}",
            allowed="an array of numbers without names",
            remedy="take the names away, if the columns stand in the order that is asked for",
        )
    left_out = left_out or ["names of columns"] * read.is_headed
    return columns, ", ".join(left_out) + ": left out" if left_out else ""


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
    if is_headed := _numbers(rows[0], mark) is None or lacks_one:
        names, rows = [""] * lacks_one + [name.strip() for name in rows[0]], rows[1:]
    elif lines[0].startswith("#"):  # as numpy.savetxt writes a header
        said = next(csv.reader([lines[0].lstrip("# ")], delimiter=mark or " "))
        names = [name.strip() for name in said] if len(said) == len(rows[0]) else []
    texts = _texts(names, rows, mark)
    values = [_numbers(["nan" if k in texts else one for k, one in enumerate(row)], mark) for row in rows]
    for number, row in enumerate(values, 1):
        if row is None or len(row) != len(values[0] or ()):
            raise InputError(f"{path}: row {number} is no row of numbers like the others", allowed=allowed)
    if not values:
        raise InputError(f"{path}: names, and no rows", allowed=allowed)
    columns = np.array(values, np.float64)
    if names and len(names) != columns.shape[1]:
        raise InputError(f"{path}: {len(names)} names for {columns.shape[1]} columns", allowed=allowed)
    return Table(names, columns, is_headed)


def _texts(names: list[str], rows: list[list[str]], mark: str | None) -> set[int]:
    """Return which named columns hold no number: names of pictures and of frames, dates; or a row without names did."""
    texts = {k for k in range(len(names)) if all(_numbers(row[k : k + 1], mark) is None for row in rows)}
    is_row = bool(names and names[0]) and any(
        _numbers([name], mark) is not None for k, name in enumerate(names) if k not in texts
    )
    return set() if is_row else texts


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
