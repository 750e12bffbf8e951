"""Reading HDF5 files that are not trusted: damaged, from elsewhere, or malicious.

Here: `check_text_heaps`, to be called before the library opens a file, and `SuspectFile`, through which it is read. A
reader follows no links, opens no second file, and knows the size of an array before it allocates memory for it. Not
here: the contents of a file (`gs2ci.core.storage`, `gs2ci.core.foreign`, `gs2ci_calibration.bundle`).

Variable-length texts are stored in «global heaps». The library walks a heap from object to object by the sizes it finds
there, and never ends at a damaged size of zero (HDF5 2.0.0, `H5HG__cache_heap_deserialize`): this happened with a
capture file with eight changed bytes. So heaps are checked here first.
"""

import math
import mmap
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import StorageError
from gs2ci.core.limits import DEFLATE_LIMIT, LIMIT_BYTES

TEXT_LIMIT_BYTES: Final = 16 * 2**20
NOT_OURS: Final = "the file was not written by gs2ci, or is damaged: write it again from its source"
# Format specification, section III.E: signature, version 1, three zeros, size; then objects of index, count, four
# zeros and size; object 0 is the free rest.
_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEADER_BYTES = 16


def check_text_heaps(path: Path) -> None:
    """Check that every global heap of a file can be walked to its end.

    Raises:
        ValueError: One cannot; names its position.
        OSError: The file cannot be read.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_SIGNATURE)
        while at >= 0:
            _walk(data, at)
            at = data.find(_SIGNATURE, at + 1)


def _walk(data: mmap.mmap, start: int) -> None:
    end = start + _HEADER_BYTES
    if end <= len(data):
        end = start + struct.unpack_from("<Q", data, start + 8)[0]
    at = start + _HEADER_BYTES
    # Less than an object's header may be left over at the end; the library ignores it.
    while at + _HEADER_BYTES <= min(end, len(data)):
        index, _, _, size = struct.unpack_from("<HHIQ", data, at)
        step = size if index == 0 else _HEADER_BYTES + -(-size // 8) * 8
        if step < _HEADER_BYTES or at + step > end:
            raise ValueError(f"damaged text storage at byte {at}")
        at += step


class SuspectFile:
    """An open HDF5 file with the only safe ways to read it.

    Args:
        path: For messages.
        file: Opened for reading.
    """

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self.file = file
        self._file_bytes = path.stat().st_size

    def array(self, key: str, *, axes: int, row: int | None = None) -> NDArray[Any] | None:
        """Read a numeric dataset, or one row of it; None if the file has no such key.

        Raises:
            StorageError: Not a dataset of numbers with that many axes, or larger than the file can contain.
        """
        dataset = self.dataset(key, optional=True)
        if dataset is None:
            return None
        if dataset.dtype.kind not in "uif" or dataset.ndim != axes:
            raise self.wrong(key, f"{dataset.dtype} with {dataset.ndim} axes", f"numbers with {axes} axes")
        if row is not None and not 0 <= row < dataset.shape[0]:
            raise self.wrong(key, f"{dataset.shape[0]} rows, row {row} is missing")
        shape = dataset.shape if row is None else dataset.shape[1:]
        self._check_bytes(key, shape, dataset)
        values = np.asarray(dataset[()] if row is None else dataset[row])
        return values.astype(values.dtype.newbyteorder("="), copy=False)

    def require(self, key: str, *, axes: int) -> NDArray[Any]:
        """Read a numeric dataset that every capture file has.

        Raises:
            StorageError: It is missing; or as `array`.
        """
        values = self.array(key, axes=axes)
        if values is None:
            raise self.wrong(key, "missing")
        return values

    def text(self, key: str, row: int | None = None) -> str | None:
        """Read a text, or one row of a list of texts; None if the file has no such key.

        Raises:
            StorageError: Not a text, or too long.
        """
        dataset = self.dataset(key, optional=True)
        if dataset is None:
            return None
        if h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != (0 if row is None else 1):
            raise self.wrong(key, f"{dataset.dtype} with {dataset.ndim} axes", "text")
        if dataset.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise self.wrong(key, f"a text of {dataset.dtype.itemsize} bytes", f"up to {TEXT_LIMIT_BYTES}")
        value = dataset[()] if row is None else dataset[row]
        if not isinstance(value, bytes):
            raise self.wrong(key, "not a text")
        return value.decode("utf-8")

    def number(self, key: str, attribute: str, default: float) -> float:
        """Read a numeric attribute of a dataset; NaN counts as absent if the default is NaN.

        Raises:
            StorageError: The dataset is missing, or its attribute is no finite number.
        """
        value = self.attribute(self.dataset(key), attribute, key)
        value = default if value is None else value
        if not isinstance(value, int | float | np.integer | np.floating):
            raise self.wrong(key, f"attribute {attribute} = {value!r}", "a number")
        if not np.isfinite(value) and not np.isnan(default):
            raise self.wrong(key, f"attribute {attribute} = {value}", "a finite number")
        return float(value)

    def wrong(self, key: str, problem: str, allowed: str = "") -> StorageError:
        """Make the error for a key of this file."""
        return StorageError(f"{self.path}: key {key!r}: {problem}", allowed=allowed, remedy=NOT_OURS)

    def numbers(self, key: str) -> Any:
        """Get an h5py dataset for its shape and dtype, or None; its values are read through `array`."""
        return self.dataset(key, optional=True)

    def texts(self, key: str) -> Iterator[str]:
        """Read a list of texts, one by one; empty if the file has no such key."""
        dataset = self.dataset(key, optional=True)
        if dataset is not None and dataset.ndim == 1:
            for row in range(min(dataset.shape[0], self._file_bytes)):
                yield self.text(key, row) or ""

    def dataset(self, key: str, *, optional: bool = False) -> Any:
        """Walk to a dataset along hard links only; a link could lead into any file of this machine.

        Raises:
            StorageError: It is missing (unless it may be: then None is returned), no dataset, or in another file.
        """
        node: Any = self.file
        for part in key.split("/"):
            if not isinstance(node, h5py.Group):
                raise self.wrong(key, "its parent is not a group")
            link = node.get(part, getlink=True)
            if link is None:
                if optional:
                    return None
                raise self.wrong(key, "missing")
            if not isinstance(link, h5py.HardLink):
                raise self.wrong(key, "a link to elsewhere", "data inside the file")
            node = node[part]
        if not isinstance(node, h5py.Dataset):
            raise self.wrong(key, "not a dataset")
        if node.is_virtual or node.external:
            raise self.wrong(key, "its data lie in another file", "data inside the file")
        return node

    def keys(self, at: str) -> list[str]:
        """List the members of a group, in order; empty if no group is reached along hard links."""
        node: Any = self.file
        for part in at.split("/"):
            if not isinstance(node, h5py.Group) or not isinstance(node.get(part, getlink=True), h5py.HardLink):
                return []
            node = node[part]
        return sorted(node) if isinstance(node, h5py.Group) else []

    def attribute(self, node: Any, name: str, key: str) -> object:
        """Read an attribute of a dataset or group; None if it has none of that name.

        Raises:
            StorageError: It is no single number or text, or a text that is too long.
        """
        if name not in node.attrs:
            return None
        attribute = node.attrs.get_id(name)
        if attribute.shape != () or attribute.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise self.wrong(key, f"attribute {name} is no single value")
        # A text of a damaged type is a list of variable length, at which the library ends the process (HDF5 2.0.0).
        if attribute.dtype.kind not in "buif" and h5py.check_string_dtype(attribute.dtype) is None:
            raise self.wrong(key, f"attribute {name} is {attribute.dtype}", "a number or a text")
        return node.attrs[name]

    def _check_bytes(self, key: str, shape: tuple[int, ...], dataset: Any) -> None:
        # A chunk is always decompressed as a whole, even if only part of it is requested.
        wanted = dataset.dtype.itemsize * max(math.prod(shape), math.prod(dataset.chunks or ()))
        allowed = min(LIMIT_BYTES, DEFLATE_LIMIT * self._file_bytes)
        if wanted > allowed:
            raise self.wrong(key, f"claims {wanted} bytes in a file of {self._file_bytes}", f"at most {allowed}")
