"""Which format a file is, from its first bytes, not its name."""

from pathlib import Path
from typing import Final

import h5py

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Container, damage_as_input_error
from gs2ci.core.foreign.mat5 import read_mat5
from gs2ci.core.foreign.mat73 import read_mat73
from gs2ci.core.foreign.npy import read_npy
from gs2ci.core.foreign.npz import read_npz
from gs2ci.core.foreign.pictures import is_picture, read_pictures

_FORMATS: Final = ".npz, .npy, .mat (version 5 to 7.3), or pictures (PNG, TIFF, BMP, PGM, or a folder of them)"


def open_foreign(path: Path) -> Container:
    """Open a foreign file.

    Raises:
        InputError: Missing, empty, of no known format, or damaged.
    """
    if path.is_dir():
        return read_pictures(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file", remedy="check the name")
    with damage_as_input_error(str(path)):
        with path.open("rb") as stream:
            start = stream.read(128)
        hdf5 = bool(h5py.is_hdf5(path))
    if start.startswith(b"\x93NUMPY"):
        return read_npy(path)
    if start.startswith(b"PK"):
        return read_npz(path)
    if hdf5:
        return read_mat73(path)
    if start.startswith(b"MATLAB"):
        return read_mat5(path)
    if is_picture(start):
        return read_pictures(path)
    raise InputError(
        f"{path}: {'empty' if not start else 'its content is of no known format'}",
        allowed=_FORMATS,
        remedy="save the measurement and its masks in one of these",
    )
