"""A foreign file as a set of named arrays, described before they are loaded.

Here: `Container`, `ArrayEntry`, `Array` (numbers with the place they came from), and the two errors every format
shares: a file that cannot be understood, and an array that is too large to be true. Not here: any format.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.limits import LIMIT_BYTES

ENTRY_LIMIT: Final = 10_000

_WAYS_OUT: Final = {
    "a MATLAB struct": "save its fields as variables: save('FILE.mat', '-struct', 'NAME')",
    "a MATLAB cell array": "save it as one array: masks = cat(3, NAME{:}); save('FILE.mat', 'meas', 'masks')",
    "a MATLAB sparse matrix": "save it as full(NAME)",
    "complex numbers": "save their real part or magnitude, whichever is the reading",
    "numbers compressed by a plug-in of HDF5": "save it again with gzip or without compression (in Python, "
    "`import hdf5plugin` reads it)",
    "Python objects": "if it is a dict: np.savez('FILE.npz', **np.load(PATH, allow_pickle=True).item())",
}


@dataclass(frozen=True)
class ArrayEntry:
    """What a file says about one of its arrays.

    Args:
        shape: As numpy or MATLAB users see it.
        kind: "number", "text", or in words why it is never loaded ("Python objects", "cell array", ...).
    """

    shape: tuple[int, ...]
    kind: str


@dataclass(frozen=True)
class Array:
    """Numbers and where they came from.

    Args:
        where: For messages: «fern.npz, key 'meas'».
        values: The numbers.
    """

    where: str
    values: NDArray[Any]


@dataclass(frozen=True)
class Container:
    """A foreign file whose arrays are loaded on demand.

    Args:
        path: The file.
        entries: What it holds, by key; a format without keys has one, "".
        load_values: Loads one key; may raise anything.
        note: What was guessed on opening it, a sentence or nothing.
        used: Keys that were loaded.
        pages: How many pictures the array was stacked from.
    """

    path: Path
    entries: dict[str, ArrayEntry]
    load_values: Callable[[str], NDArray[Any]]
    note: str = ""
    used: set[str] = field(default_factory=set)
    pages: int = 1

    def where(self, key: str) -> str:
        """Name a key for messages."""
        return f"{self.path}, key {key!r}" if key else f"{self.path}"

    def load(self, key: str) -> Array:
        """Load numbers.

        Raises:
            InputError: No such key, not numbers, or the file is damaged there.
        """
        if key not in self.entries:
            raise InputError(f"{self.path}: no key {key!r}", allowed=self.listing(), remedy="name another key")
        entry = self.entries[key]
        self.used.add(key)
        if entry.kind != "number":
            raise InputError(
                f"{self.where(key)}: holds {entry.kind}",
                allowed="an array of numbers (objects are never loaded: they can run programs)",
                remedy=_WAYS_OUT.get(entry.kind, "save it again as a plain numeric array"),
            )
        with damage_as_input_error(self.where(key)):
            values = self.load_values(key)
            if values.dtype.kind not in "buif":
                raise InputError(
                    f"{self.where(key)}: numbers of type {values.dtype}",
                    allowed="real numbers",
                    remedy="convert it",
                )
            return Array(self.where(key), values)

    def text(self, key: str) -> str:
        """Load a short text.

        Raises:
            InputError: Not a text.
        """
        self.used.add(key)
        if self.entries[key].kind != "text":
            raise InputError(f"{self.where(key)}: holds no text", allowed="a text", remedy="leave it out")
        with damage_as_input_error(self.where(key)):
            text = np.asarray(self.load_values(key)).reshape(-1)[0]
            return (text.decode("utf-8") if isinstance(text, bytes) else str(text)).strip()

    def unused(self) -> str:
        """Write down what the file holds and nothing has asked for; empty if that is nothing."""
        left = {key: entry for key, entry in self.entries.items() if key not in self.used}
        # Octave writes the type of a variable beside its value.
        left = {key: entry for key, entry in left.items() if not (key.endswith("/type") and entry.kind != "number")}
        words = [f"{key!r} {list(entry.shape)}" for key, entry in list(left.items())[:30]]
        return ", ".join(words)

    def listing(self) -> str:
        """Write down what the file holds."""
        words = [
            f"{key or 'one array'} {list(entry.shape)}" + ("" if entry.kind == "number" else f" ({entry.kind})")
            for key, entry in list(self.entries.items())[:30]
        ]
        return "the file holds " + (", ".join(words) or "nothing")


@contextmanager
def damage_as_input_error(where: str) -> Iterator[None]:
    """Turn whatever a parser of foreign bytes throws into one error.

    Raises:
        InputError: Something was thrown.
    """
    try:
        yield
    except Gs2ciError:
        raise
    except Exception as error:
        # Parsers report damage as almost any built-in exception; to the user all of them mean the same.
        detail = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise InputError(
            f"{where}: cannot be read: {detail}",
            remedy="the file is damaged or not what its name says: save it again",
        ) from error


def check_bytes(where: str, shape: tuple[int, ...], itemsize: int, stored_bytes: int, expansion: int) -> None:
    """Return if an array of that shape can really be in a file of that size.

    Args:
        where: For the message.
        shape: What the file claims.
        itemsize: Bytes per number once loaded.
        stored_bytes: Bytes there are in the file.
        expansion: How many loaded bytes one stored byte can at most become.

    Raises:
        InputError: It cannot.
    """
    wanted = math.prod(shape) * itemsize
    if min(shape, default=0) < 0 or wanted > min(LIMIT_BYTES, stored_bytes * expansion):
        raise InputError(
            f"{where}: claims shape {list(shape)} ({wanted} bytes), but {stored_bytes} bytes are stored",
            allowed=f"what the file really holds, up to {LIMIT_BYTES} bytes an array",
            remedy="the file is damaged, or cut it into smaller arrays",
        )
