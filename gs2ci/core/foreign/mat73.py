"""Reading .mat of version 7.3, which is HDF5, with axes as MATLAB users see them; and HDF5 files of other programs.

MATLAB stores arrays column by column, and its files list the axes in that order. Beside each array it writes its class,
`MATLAB_class`; such arrays are transposed here. Those without it have the axes of the file, as h5py shows them. No link
is followed.
"""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ENTRY_LIMIT, ArrayEntry, Container, check_bytes, damage_as_input_error
from gs2ci.core.hdf5 import check_text_heaps
from gs2ci.core.limits import DEFLATE_LIMIT

_CLASS: Final = "MATLAB_class"
_OCTAVE: Final = "OCTAVE_NEW_FORMAT"
# R's rhdf5 says so of numbers, and Julia's JLD and JLD2 begin their files with their name.
_RHDF5: Final = "rhdf5-NA.OK"
_JULIA: Final = (b"HDF5-based Julia", b"Julia data file")
# By which netCDF packs numbers into integers (CF conventions, 8.1), and their values where they are left out.
_PACKED: Final = {"scale_factor": 1.0, "add_offset": 0.0}
# What stands for no number, there, unless it is 0, which is a reading.
_MISSING: Final = ("_FillValue", "missing_value")
_CELL: Final = {"cell": "cell array"}
# Detectors write their frames two or three groups deep (NeXus: entry/data/data).
_DEEPEST: Final = 6
_OF_R: Final = "an HDF5 file of R or Julia, whose axes are taken as they are counted there"
# Among programs that write no class, those that count axes from the other end cannot be told from h5py, but that
# sensors are wider than high.
_NOT_BY_SAVE: Final = (
    "an HDF5 file without MATLAB's classes, whose axes are taken as h5py shows them{shown}; MATLAB's h5write and "
    "Julia's HDF5.jl reverse them: save -v7.3 there, or reverse them before writing"
)


def read_mat73(path: Path) -> Container:
    """Open a MATLAB file of version 7.3, or another HDF5 file; arrays in groups have keys such as entry/data/data.

    Raises:
        InputError: Damaged, an array larger than the file can hold, or one that lies in another file.
    """
    with damage_as_input_error(str(path)):
        check_text_heaps(path)
    with damage_as_input_error(str(path)), h5py.File(path, "r") as file:
        if "schema" in file.attrs:
            raise InputError(f"{path}: is no .mat file but a capture file", remedy="reconstruct from it as it is")
        is_julia = _begins_as_julia(path)
        entries = dict(_entries(path, file, "", 0, is_julia))
        arrays = {key: file[key] for key, entry in entries.items() if entry.kind == "number"}
        note = "" if all(_is_reversed(array, is_julia) for array in arrays.values()) else _doubt(entries, arrays)
        if is_julia or any(_RHDF5 in array.attrs for array in arrays.values()):
            note = _OF_R
    return Container(path, entries, lambda key: _load73(path, key, is_julia), note)


def _doubt(entries: dict[str, ArrayEntry], arrays: Iterable[str]) -> str:
    """Say that axes may be reversed; the two longest sides of the largest array are those of its pictures."""
    key = max(arrays, key=lambda one: math.prod(entries[one].shape))
    shape = entries[key].shape
    longest = sorted(range(len(shape)), key=lambda axis: -shape[axis])[:2]
    high, *wide = (shape[axis] for axis in sorted(longest)) if shape else (0,)
    if not wide or high <= wide[0]:
        return _NOT_BY_SAVE.format(shown="")
    return "WARNING: " + _NOT_BY_SAVE.format(shown=f", {key!r} {high} pixels high and {wide[0]} wide")


def _entries(
    path: Path, group: h5py.Group, prefix: str, depth: int, is_julia: bool
) -> Iterator[tuple[str, ArrayEntry]]:
    """Describe what a group holds, and what the groups in it hold."""
    if len(group) > ENTRY_LIMIT:
        raise InputError(f"{path}: {len(group)} variables", allowed=f"up to {ENTRY_LIMIT}", remedy="save fewer")
    for name in group:
        if name.startswith("#"):
            continue
        key = f"{prefix}{name}"
        within = isinstance(group.get(name, getlink=True), h5py.HardLink) and isinstance(group[name], h5py.Group)
        if within and depth < _DEEPEST and len(group[name]):
            yield from _entries(path, group[name], f"{key}/", depth + 1, is_julia)
        else:
            yield key, _entry73(path, group, name, key, is_julia)


def _is_reversed(node: h5py.Dataset, is_julia: bool) -> bool:
    """Tell whether an array's axes stand in MATLAB's order: MATLAB says its class, Octave marks the group about it."""
    return is_julia or _CLASS in node.attrs or _RHDF5 in node.attrs or _OCTAVE in node.parent.attrs


def _begins_as_julia(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(32).startswith(_JULIA)


def _entry73(path: Path, group: h5py.Group, name: str, key: str, is_julia: bool) -> ArrayEntry:
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        return ArrayEntry((), "a link")
    node = group[name]
    if not isinstance(node, h5py.Dataset):
        return ArrayEntry((), "a MATLAB struct")
    shape = tuple(node.shape or ())
    if _is_reversed(node, is_julia):
        shape = shape[::-1]
    if node.is_virtual or node.external:
        return ArrayEntry(shape, "a link")
    filters = node.id.get_create_plist()
    if not all(h5py.h5z.filter_avail(filters.get_filter(k)[0]) for k in range(filters.get_nfilters())):
        return ArrayEntry(shape, "numbers compressed by a plug-in of HDF5")
    kind = node.attrs.get(_CLASS, b"")
    if kind == b"char":
        check_bytes(f"{path}, key {key!r}", shape, node.dtype.itemsize, 2**16, expansion=1)
        return ArrayEntry(shape, "text")
    if node.dtype.kind not in "buif" or "MATLAB_empty" in node.attrs:
        if not kind:
            return ArrayEntry(shape, f"an array of {'texts' if node.dtype.kind in 'OS' else node.dtype}")
        words = kind.decode(errors="replace")
        return ArrayEntry(shape, f"a MATLAB {_CELL.get(words, words)}")
    chunk = node.chunks or (1,)
    for extent in (shape, chunk):
        check_bytes(f"{path}, key {key!r}", extent, node.dtype.itemsize, path.stat().st_size, DEFLATE_LIMIT)
    return ArrayEntry(shape, "number")


def _load73(path: Path, key: str, is_julia: bool) -> NDArray[Any]:
    with h5py.File(path, "r") as file:
        node = file[key]
        values, kind = np.asarray(node[()]), node.attrs.get(_CLASS)
        values = values.T if _is_reversed(node, is_julia) else values
        if kind == b"char":
            return np.asarray("".join(map(chr, values.reshape(-1))))
        factor, offset = (float(np.ravel(node.attrs.get(name, usual))[0]) for name, usual in _PACKED.items())
        missing = (values != 0) & np.isin(
            values, [np.ravel(node.attrs[name])[0] for name in _MISSING if name in node.attrs]
        )
        if values.dtype.kind == "i" and node.attrs.get("_Unsigned") in ("true", b"true"):
            values = values.view(f"{values.dtype.byteorder}u{values.dtype.itemsize}")
    if missing.any() or factor != 1 or offset != 0:
        return np.where(missing, np.nan, values * factor + offset)
    return values.astype(values.dtype.newbyteorder("="), copy=False)
