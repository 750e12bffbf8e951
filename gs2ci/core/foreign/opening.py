"""Which format a file is, from its first bytes, not its name; and the only array of a file."""

import struct
from pathlib import Path
from typing import Final

import h5py

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import Array, Container, damage_as_input_error
from gs2ci.core.foreign.mat5 import read_mat5
from gs2ci.core.foreign.mat73 import read_mat73
from gs2ci.core.foreign.npz import TORCH_WAY_OUT, read_npy, read_npz
from gs2ci.core.foreign.pictures import is_picture, read_pictures
from gs2ci.core.foreign.roles import ALIASES, Role, key_of
from gs2ci.core.foreign.text import is_numbers, read_text

_FORMATS: Final = (
    ".npz, .npy, .mat (version 5 to 7.3), a text of numbers, or pictures (PNG, TIFF, BMP, PGM, or a folder of them)"
)

_ZARR: Final = ("zarr.json", ".zarray", ".zgroup")
_LOSSLESS: Final = "save the camera's readings as 16-bit PNG or TIFF"
_FRAMES: Final = (
    "if it was stored without loss, save its frames as pictures: ffmpeg -i FILE -pix_fmt gray FOLDER/%04d.png; "
    "otherwise take the patterns from where the film was made"
)
_TUM: Final = "save its poses as a text of TUM's form (time, place, quaternion), its pictures as 16-bit PNG or TIFF"
_UNPACK: Final = "unpack it, and give what it holds"
# First bytes of formats that people have, their names, and how their numbers come into a format that is read.
UNREAD: Final = (
    (b"SIMPLE  =", "a FITS file", "in Python: np.save('FILE.npy', astropy.io.fits.getdata(PATH).astype(float))"),
    (b"CDF", "a netCDF of version 3", "in Python: xarray.open_dataset(PATH).to_netcdf('FILE.h5', engine='h5netcdf')"),
    (b"#ROSBAG", "a bag of ROS", _TUM),
    (b"\x89MCAP", "a bag of ROS (MCAP)", _TUM),
    (b"SQLite format 3", "a database, as bags of ROS 2 are", _TUM),
    (b"# Created by Octave", "a text file of Octave", "save it again there: save -v7 FILE.mat meas masks"),
    (b"Octave-1-", "a binary file of Octave", "save it again there: save -v7 FILE.mat meas masks"),
    (b"\x80\x02", "a file of Python objects (pickle, an old .pt)", TORCH_WAY_OUT),
    (b"\x80\x03", "a file of Python objects (pickle)", "in Python: np.savez('FILE.npz', meas=..., masks=...)"),
    (b"\x80\x04", "a file of Python objects (pickle)", "in Python: np.savez('FILE.npz', meas=..., masks=...)"),
    (b"\x80\x05", "a file of Python objects (pickle)", "in Python: np.savez('FILE.npz', meas=..., masks=...)"),
    (b"P1", "a PBM of text", "save the masks as 8-bit PNG"),
    (b"P2", "a PGM of text", "save it as a binary PGM (P5) or PNG"),
    (b"P3", "a PPM of text", _LOSSLESS),
    (b"P4", "a PBM", "save the masks as 8-bit PNG"),
    (b"P6", "a PPM", _LOSSLESS),
    (b"P7", "a PAM", _LOSSLESS),
    (b"PF", "a PFM", "save it as 32-bit TIFF, or as .npy"),
    (b"Pf", "a PFM", "save it as 32-bit TIFF, or as .npy"),
    (b"GIF8", "a GIF", _LOSSLESS),
    (b"RIFF", "a WebP picture or an AVI film", _LOSSLESS),
    (b"SDPX", "a DPX picture", _LOSSLESS),
    (b"XPDS", "a DPX picture", _LOSSLESS),
    (b"v/1\x01", "an EXR picture", "save it as 32-bit TIFF, or as .npy"),
    (b"\xff\x0a", "a JPEG XL picture", _LOSSLESS),
    (b"\xff\x4f\xff\x51", "a JPEG 2000 picture", _LOSSLESS),
    (b"\x1aE\xdf\xa3", "a film (Matroska, WebM)", _FRAMES),
    (b"\x1f\x8b", "packed by gzip", _UNPACK),
    (b"BZh", "packed by bzip2", _UNPACK),
    (b"\xfd7zXZ\0", "packed by xz", _UNPACK),
    (b"7z\xbc\xaf", "a 7z archive", _UNPACK),
    (b"Rar!", "a RAR archive", _UNPACK),
    (
        b"{",
        "a JSON file",
        "in Python: np.savez('FILE.npz', meas=..., masks=...); a camera's is for --intrinsics, --poses",
    ),
)


def open_foreign(path: Path) -> Container:
    """Open a foreign file.

    Raises:
        InputError: Missing, empty, of no known format, or damaged.
    """
    if path.is_dir():
        if any((path / name).is_file() for name in _ZARR):
            raise InputError(
                f"{path}: a Zarr store, which is not read",
                allowed=_FORMATS,
                remedy="in Python: np.savez('FILE.npz', meas=group['meas'][:], masks=group['masks'][:])",
            )
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
    _refuse_by_name(path, start)
    if is_numbers(start, path.suffix):
        return read_text(path)
    raise InputError(
        f"{path}: {'empty' if not start else 'its content is of no known format'}",
        allowed=_FORMATS,
        remedy="save it in one of these by a program that reads it; if it holds pixels alone, without a header, in "
        "Python: np.save('FILE.npy', np.fromfile(PATH, '<u2').reshape(H, W)); pixels that are packed to 12 bits, 1.5 "
        "bytes each, have to be unpacked first",
    )


def _refuse_by_name(path: Path, start: bytes) -> None:
    """Refuse a format that is known and not read, with the way out of it."""
    found = next((way for mark, *way in UNREAD if start.startswith(mark)), None)
    if found is None and start[4:12] in (b"jP  \r\n\x87\n", b"ftypavif", b"ftypheic"):
        found = ["a JPEG 2000, AVIF or HEIC picture", _LOSSLESS]
    if found is None and start[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free"):
        found = ["a film (MP4, MOV)", _FRAMES]
    if start.startswith(b"RIFF") and start[8:12] == b"AVI ":
        found = ["an AVI film", _FRAMES]
    if found is None and _is_mat4(start):
        found = ["a .mat of version 4", "save it again in MATLAB or Octave: save -v7 FILE.mat meas masks"]
    if found is not None:
        raise InputError(f"{path}: {found[0]}, which is not read", allowed=_FORMATS, remedy=found[1])


def _is_mat4(start: bytes) -> bool:
    """Tell a .mat of version 4: whole numbers for type, rows, columns, imaginary, length of the name; and the name."""
    for order in "<>":
        if len(start) < 21:
            return False
        kind, rows, columns, imaginary, length = struct.unpack_from(order + "5i", start)
        sizes = rows >= 0 and columns >= 0 and imaginary in (0, 1) and 1 < length < 64
        if 0 <= kind < 5000 and kind % 10 <= 2 and kind // 10 % 10 <= 5 and sizes:
            name = start[20 : 20 + length - 1]
            return name.isascii() and name.decode("ascii").isidentifier()
    return False


def load_single(path: Path, role: Role | None = None, said: str | None = None) -> Array:
    """Load the only array of a file (true views, poses, a camera matrix), or of several the one that plays a role.

    Args:
        path: The file.
        role: Of the array, which a name in use then tells among several.
        said: Its key, if the user named it.

    Raises:
        InputError: No array of numbers there; or several, none of which is named so.
    """
    container = open_foreign(path)
    keys: list[str | None] = [key for key, entry in container.entries.items() if entry.kind == "number"]
    if role is not None and (said is not None or len(keys) != 1):
        keys = [key_of(container, role, said, [])]
    if len(keys) != 1 or keys[0] is None:
        raise InputError(
            f"{path}: {container.listing()}",
            allowed="a file with a single array of numbers"
            + (f", or one of several named {', '.join(ALIASES[role])}" if role is not None else ""),
            remedy="save it alone: np.save('FILE.npy', array)",
        )
    return container.load(keys[0])
