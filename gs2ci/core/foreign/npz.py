"""Reading .npy, one array without a name, under the key ""; and .npz, a zip archive of such members."""

import warnings
import zipfile
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.lib import format as npy_format
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ENTRY_LIMIT, ArrayEntry, Container, check_bytes, damage_as_input_error
from gs2ci.core.limits import DEFLATE_LIMIT


def read_npy(path: Path) -> Container:
    """Open a .npy file.

    Raises:
        InputError: Damaged, or larger than the file can hold.
    """
    with damage_as_input_error(str(path)), path.open("rb") as stream:
        entry = _describe(stream, str(path), path.stat().st_size, expansion=1)

    def load(_: str) -> NDArray[Any]:
        with path.open("rb") as stream:
            return _array(stream)

    return Container(path, {"": entry}, load)


def _describe(stream: IO[bytes], where: str, stored_bytes: int, expansion: int) -> ArrayEntry:
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


def _array(stream: IO[bytes]) -> NDArray[Any]:
    """Load an array whose header was found sound; Python objects are refused."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asarray(npy_format.read_array(stream, allow_pickle=False))


TORCH_WAY_OUT: Final = (
    "in Python: np.savez('FILE.npz', **{name: t.cpu().numpy() for name, t in torch.load(PATH).items()})"
)


def read_npz(path: Path) -> Container:
    """Open a .npz file.

    Raises:
        InputError: Damaged, or an array larger than the file can hold.
    """
    with damage_as_input_error(str(path)), zipfile.ZipFile(path) as archive:
        if any(name.endswith(("/data.pkl", "/.data/serialization_id")) for name in archive.namelist()):
            raise InputError(
                f"{path}: a file of PyTorch (.pt, .pth), which can run programs and is not read",
                allowed="a .npz of numpy",
                remedy=TORCH_WAY_OUT,
            )
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        if len(members) > ENTRY_LIMIT or len({info.filename for info in members}) < len(members):
            raise InputError(f"{path}: {len(members)} arrays, or two of one name", remedy="save the file again")
        if not members:
            raise InputError(
                f"{path}: a zip archive without an array of numpy",
                allowed="a .npz of numpy",
                remedy="unpack it (a spreadsheet: save as CSV); in Python: np.savez('FILE.npz', meas=..., masks=...)",
            )
        entries = {info.filename.removesuffix(".npy"): _entry(path, archive, info) for info in members}
    return Container(path, entries, lambda key: _load(path, key))


def _entry(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> ArrayEntry:
    where = f"{path}, key {info.filename.removesuffix('.npy')!r}"
    with damage_as_input_error(where), archive.open(info) as stream:
        return _describe(stream, where, info.compress_size, expansion=DEFLATE_LIMIT)


def _load(path: Path, key: str) -> NDArray[Any]:
    with zipfile.ZipFile(path) as archive, archive.open(f"{key}.npy") as stream:
        values = _array(stream)
        stream.read(1)  # reaching the end makes zipfile compare the checksum
        return values
