"""Reading .npy: one array without a name, under the key "".

Here also: `describe`, the header of such an array wherever it lies (.npz holds many).
"""

import warnings
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from gs2ci.core.foreign.container import ArrayEntry, Container, check_bytes, damage_as_input_error


def read_npy(path: Path) -> Container:
    """Open a .npy file.

    Raises:
        InputError: Damaged, or larger than the file can hold.
    """
    with damage_as_input_error(str(path)), path.open("rb") as stream:
        entry = describe(stream, str(path), path.stat().st_size, expansion=1)
    return Container(path, {"": entry}, lambda key: _load(path))


def describe(stream: IO[bytes], where: str, stored_bytes: int, expansion: int) -> ArrayEntry:
    """Read an array's header and nothing more.

    Raises:
        InputError: The header claims more than can be there.
        Exception: Whatever numpy says about a damaged header.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # headers written by Python 2 parse all the same
        version = npy_format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            return ArrayEntry((), "an array with named fields")
        read_header = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        return ArrayEntry(shape, "Python objects")
    check_bytes(where, shape, dtype.itemsize, stored_bytes, expansion)
    if dtype.kind in "US":
        return ArrayEntry(shape, "text")
    return ArrayEntry(shape, "number" if dtype.kind in "buifc" else f"{dtype} values")


def _load(path: Path) -> NDArray[Any]:
    with path.open("rb") as stream:
        return load_array(stream)


def load_array(stream: IO[bytes]) -> NDArray[Any]:
    """Load an array whose header was found sound; Python objects are refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(npy_format.read_array(stream, allow_pickle=False))
