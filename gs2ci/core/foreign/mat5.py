"""Reading .mat of version 5 to 7.2: numeric arrays and texts, also in the fields of a struct, nothing else.

Why not scipy.io: its compiled reader trusts the type codes it finds, and damaged files kill the process instead of
raising (`python -m tests.benchmarks by_hand`). The part of the format that a measurement needs is small: elements of a
type, a length and data, arrays as elements of flags, sizes, name and numbers (MathWorks, "MAT-File Format", chapter 1).
"""

import math
import struct
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8
from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ENTRY_LIMIT, ArrayEntry, Container, check_bytes, damage_as_input_error
from gs2ci.core.limits import DEFLATE_LIMIT, LIMIT_BYTES

HEADER_BYTES: Final = 128
_MATRIX, _COMPRESSED = 14, 15
# How numbers are stored (table 1-1), and what they are for MATLAB (table 1-3); the former may be the smaller type.
_STORED: Final = {
    **dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4"), 1)),
    9: "f8",
    12: "i8",
    13: "u8",
    **dict(enumerate(("u1", "u2", "u4"), 16)),
}
_CLASSES: Final = dict(enumerate(("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), 6))
_OTHER_CLASSES: Final = {
    1: "cell array",
    2: "struct",
    3: "object",
    5: "sparse matrix",
    16: "function",
    17: "object",
}
_STRUCT, _CHAR, _OPAQUE = 2, 4, 17
_COMPLEX, _LOGICAL = 0x0800, 0x0200
# Flags, sizes and name of an array fit in here; more is only unpacked to load it.
_HEAD_BYTES: Final = 4096


@dataclass(frozen=True)
class _Matrix:
    """An array's description and where its numbers begin.

    Args:
        name: Variable name.
        shape: Sizes.
        kind: MATLAB class code.
        flags: Complex, global, logical.
        data_at: Position of the element with the numbers, in the array's bytes.
    """

    name: str
    shape: tuple[int, ...]
    kind: int
    flags: int
    data_at: int


@dataclass(frozen=True)
class _Place:
    """Where an array lies in the file.

    Args:
        at: Position of its bytes, or of those of the struct of which it is a field.
        count: Number of these (maybe compressed) bytes.
        compressed: Whether they are.
        within: Where among the unpacked bytes of the struct its own begin and end; None: it is no field.
    """

    at: int
    count: int
    compressed: bool
    within: tuple[int, int] | None = None


def read_mat5(path: Path) -> Container:
    """Open a MATLAB file of version 5 to 7.2.

    Raises:
        InputError: Damaged, or an array larger than the file can hold.
    """
    entries: dict[str, ArrayEntry] = {}
    places: dict[str, _Place] = {}
    with damage_as_input_error(str(path)):
        data = np.memmap(path, np.uint8, "r")
        order = _byte_order(data, path)
        at = HEADER_BYTES
        while at + 8 <= len(data):
            code, count = struct.unpack(order + "II", bytes(data[at : at + 8]))
            place = _Place(at + 8, count, code == _COMPRESSED)
            if code not in (_MATRIX, _COMPRESSED) or place.at + count > len(data):
                raise InputError(f"{path}: damaged or truncated at byte {at}", remedy="save it again")
            matrix = _describe(_head(data, place), order)
            at = place.at + count
            if not matrix.name:
                continue  # MATLAB's own notes on functions and objects
            for one, where in _fields(path, matrix, place, order) or [(matrix, place)]:
                if one.name in entries:
                    raise InputError(f"{path}: variable {one.name!r} is there twice", remedy="save it again")
                if len(entries) >= ENTRY_LIMIT:
                    raise InputError(f"{path}: too many variables", allowed=f"up to {ENTRY_LIMIT}", remedy="save fewer")
                entries[one.name] = _entry(path, one, where)
                places[one.name] = where
    return Container(path, entries, lambda key: _load(path, places[key], order))


def _byte_order(data: U8, path: Path) -> str:
    mark = bytes(data[126:128])
    if len(data) < HEADER_BYTES or mark not in (b"IM", b"MI"):
        raise InputError(f"{path}: no byte order mark in its header", remedy="the file is damaged: save it again")
    return "<" if mark == b"IM" else ">"


def _head(data: U8, place: _Place) -> bytes:
    if not place.compressed:
        return bytes(data[place.at : place.at + min(place.count, _HEAD_BYTES)])
    # A compressed element holds a whole array element, with its own type and length in front.
    packed = bytes(data[place.at : place.at + min(place.count, 4 * _HEAD_BYTES)])
    return zlib.decompressobj().decompress(packed, _HEAD_BYTES)[8:]


def _describe(head: bytes, order: str) -> _Matrix:
    _, flags_at, count, at = _element(head, 0, order)
    if count != 8:
        raise ValueError("array flags expected")
    flags = struct.unpack_from(order + "I", head, flags_at)[0]
    kind = flags & 0xFF
    if kind == _OPAQUE:  # has no sizes
        _, name_at, count, at = _element(head, at, order)
        return _Matrix(head[name_at : name_at + count].decode("latin-1"), (), kind, flags, at)
    code, sizes_at, count, at = _element(head, at, order)
    if code != 5 or count % 4 or not 8 <= count <= 128:
        raise ValueError("array sizes expected")
    shape = struct.unpack_from(f"{order}{count // 4}i", head, sizes_at)
    _, name_at, count, at = _element(head, at, order)
    return _Matrix(head[name_at : name_at + count].decode("latin-1"), shape, kind, flags, at)


def _fields(path: Path, struct_: _Matrix, place: _Place, order: str) -> list[tuple[_Matrix, _Place]]:
    """Describe the fields of a single struct, under names as STRUCT/FIELD; of anything else none."""
    if struct_.kind != _STRUCT or math.prod(struct_.shape) != 1:
        return []
    data = _unpacked(path, place)
    _, length_at, _, at = _element(data, struct_.data_at, order)
    (length,) = struct.unpack_from(order + "i", data, length_at)
    _, names_at, count, at = _element(data, at, order)
    found = []
    for start in range(names_at, names_at + count, length):
        name = data[start : start + length].split(b"\0")[0].decode("latin-1")
        code, begin, size, at = _element(data, at, order)
        if code != _MATRIX or begin + size > len(data):
            raise ValueError("a field of a struct expected")
        if size:  # an empty array may be left out
            field = _describe(data[begin : begin + min(size, _HEAD_BYTES)], order)
            found.append((replace(field, name=f"{struct_.name}/{name}"), replace(place, within=(begin, begin + size))))
    return found


def _element(data: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Read an element's tag: type, position and number of its bytes, position of the next element."""
    code, count = struct.unpack_from(order + "II", data, at)
    if code >> 16:  # a small element: its length sits in the tag, up to four bytes beside it
        small = code >> 16
        if small > 4:
            raise ValueError("a small element of more than four bytes")
        return code & 0xFFFF, at + 4, small, at + 8
    return code, at + 8, count, at + 8 + -(-count // 8) * 8


def _entry(path: Path, matrix: _Matrix, place: _Place) -> ArrayEntry:
    where = f"{path}, key {matrix.name!r}"
    if matrix.kind == _CHAR:
        check_bytes(where, matrix.shape, 4, place.count, 4 * DEFLATE_LIMIT)
        return ArrayEntry(matrix.shape, "text")
    if matrix.kind not in _CLASSES:
        return ArrayEntry(matrix.shape, f"a MATLAB {_OTHER_CLASSES.get(matrix.kind, f'class {matrix.kind}')}")
    if matrix.flags & _COMPLEX:
        return ArrayEntry(matrix.shape, "complex numbers")
    # Doubles may be stored as single bytes, and then deflated.
    itemsize = np.dtype(_CLASSES[matrix.kind]).itemsize
    check_bytes(where, matrix.shape, itemsize, place.count, 8 * (DEFLATE_LIMIT if place.compressed else 1))
    return ArrayEntry(matrix.shape, "number")


def _unpacked(path: Path, place: _Place) -> bytes:
    """Return the bytes of an array, without compression."""
    with path.open("rb") as stream:
        stream.seek(place.at)
        data = stream.read(place.count)
    if place.compressed:
        unpacked = zlib.decompressobj().decompress(data, min(LIMIT_BYTES + 2**16, DEFLATE_LIMIT * len(data)))
        data = unpacked[8:]
    return data[slice(*place.within)] if place.within else data


def _load(path: Path, place: _Place, order: str) -> NDArray[Any]:
    data = _unpacked(path, place)
    matrix = _describe(data, order)
    code, at, count, _ = _element(data, matrix.data_at, order)
    stored = np.dtype(order + _STORED[code])
    numbers = math.prod(matrix.shape)
    if matrix.kind == _CHAR:
        return np.asarray("".join(map(chr, np.frombuffer(data[at : at + count], stored).tolist())))
    if count != numbers * stored.itemsize or at + count > len(data):
        raise ValueError(f"{count} bytes of numbers for sizes {list(matrix.shape)}")
    target = np.dtype(np.bool_ if matrix.flags & _LOGICAL else _CLASSES[matrix.kind])
    return np.frombuffer(data, stored, numbers, at).astype(target).reshape(matrix.shape, order="F")
