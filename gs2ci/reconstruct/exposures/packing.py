r"""Records of arrays as one file that only holds numbers and words: what an unfinished joint run keeps.

A file is a pickle that names classes of this program and gives their fields. Its reader finds nothing but these, and
what makes arrays and tensors, so that reading runs nothing (the Python documentation's "Restricting globals"). Arrays
that several fields share are written once and shared again.

    gs2ci.unfinished/2 KEY SHA256\n      what follows is whole, and of these sources and settings
    a pickle

Here: the two directions. Not here: what is kept, and where (`unfinished`).
"""

import hashlib
import io
import pickle
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from types import BuiltinFunctionType, FunctionType
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.reconstruct.measurement.holdout import Holdout

MARK: Final = b"gs2ci.unfinished/2"
LONGEST_HEADER: Final = 200
_OURS: Final = "gs2ci."
# What makes arrays and their numbers, of NumPy.
_NUMPY: Final = ("ndarray", "dtype", "_reconstruct", "_frombuffer", "scalar")


class UnreadableError(ValueError):
    """A file is none of these, or damaged."""


def packed(value: Any, key: str, known: Mapping[str, NDArray[Any]] | None = None) -> bytes:
    """Return a value as the content of a file.

    Args:
        value: Records, enumerations, arrays, tensors, plain values, and lists, tuples and maps of these.
        key: What it is of.
        known: Arrays that whoever reads it has, by name; they are not written.

    Raises:
        TypeError: It holds something else.
    """
    content = io.BytesIO()
    _Packer(content, {id(array): name for name, array in (known or {}).items()}).dump(value)
    body = content.getbuffer()
    return b" ".join((MARK, key.encode(), hashlib.sha256(body).hexdigest().encode())) + b"\n" + body


def key_of(content: bytes) -> str:
    """Return what a file is of.

    Raises:
        UnreadableError: It is none of these files.
    """
    parts = content[:LONGEST_HEADER].partition(b"\n")[0].split(b" ")
    if len(parts) != 3 or parts[0] != MARK:
        raise UnreadableError("it is no file of an unfinished run")
    return parts[1].decode("ascii", "replace")


def unpacked(content: bytes, known: Mapping[str, NDArray[Any]] | None = None) -> Any:
    """Return the value of a file; arguments as for `packed`.

    Raises:
        UnreadableError: It is none of these files, damaged, or of another version of this program.
    """
    key_of(content)
    header, _, body = content.partition(b"\n")
    if hashlib.sha256(body).hexdigest().encode() != header.split(b" ")[2]:
        raise UnreadableError("it is damaged")
    try:
        return _Unpacker(io.BytesIO(body), known or {}).load()
    except (pickle.UnpicklingError, LookupError, TypeError, ValueError, AttributeError, ImportError) as error:
        raise UnreadableError(f"it does not fit this version: {error}") from error


class _Packer(pickle.Pickler):
    def __init__(self, file: io.BytesIO, known: Mapping[int, str]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._known = known

    def persistent_id(self, value: Any) -> str | None:
        return self._known.get(id(value)) if isinstance(value, np.ndarray) else None

    def reducer_override(self, value: Any) -> Any:
        """Return how a value is made again; not asked for plain values and collections of them."""
        if isinstance(value, torch.Tensor):
            return tensor, (value.detach().cpu().numpy(),)
        if isinstance(value, Holdout):
            return Holdout, (value.shot, value.pixels, value.beside)
        if _is_known(type(value)) and is_dataclass(value):
            # Without what its construction converts or draws, and without what was computed since.
            return record, (type(value), {one.name: getattr(value, one.name) for one in fields(value)})
        kind = value if isinstance(value, type | FunctionType | BuiltinFunctionType) else type(value)
        if _is_known(kind) or isinstance(value, np.generic | np.dtype):
            return NotImplemented
        raise TypeError(f"{kind.__module__}.{kind.__qualname__} cannot be kept")


class _Unpacker(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, known: Mapping[str, NDArray[Any]]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, name: str) -> NDArray[Any]:
        return self._known[name]

    def find_class(self, module: str, name: str) -> Any:
        if module.partition(".")[0] in {"gs2ci", "numpy"} and _is_known(found := super().find_class(module, name)):
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is no record")


def record(kind: type, own: Mapping[str, Any]) -> Any:
    """Make a record of its fields as it was, without what its construction converts or draws.

    Raises:
        ValueError: Its fields are others.
    """
    if not is_dataclass(kind) or {one.name for one in fields(kind)} != set(own):
        raise ValueError(f"{kind.__name__} has other fields")
    made = object.__new__(kind)
    for name, value in own.items():
        object.__setattr__(made, name, value)
    return made


def tensor(array: NDArray[Any]) -> torch.Tensor:
    """Make a tensor of an array."""
    return torch.from_numpy(array)


def _is_known(maker: Any) -> bool:
    """Tell whether this may make what a file holds: a record or an enumeration of this program, or an array."""
    if str(maker.__module__).startswith("numpy"):
        return maker.__name__ in _NUMPY
    kept = isinstance(maker, type) and (is_dataclass(maker) or issubclass(maker, Enum | Holdout))
    return maker in (record, tensor) or (kept and str(maker.__module__).startswith(_OURS))
