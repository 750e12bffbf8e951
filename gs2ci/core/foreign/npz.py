"""Reading .npz: a zip archive of .npy members."""

import zipfile
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ENTRY_LIMIT, ArrayEntry, Container, damage_as_input_error
from gs2ci.core.foreign.npy import describe, load_array
from gs2ci.core.limits import DEFLATE_LIMIT

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
        entries = {info.filename.removesuffix(".npy"): _entry(path, archive, info) for info in members}
    return Container(path, entries, lambda key: _load(path, key))


def _entry(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> ArrayEntry:
    where = f"{path}, key {info.filename.removesuffix('.npy')!r}"
    with damage_as_input_error(where), archive.open(info) as stream:
        return describe(stream, where, info.compress_size, expansion=DEFLATE_LIMIT)


def _load(path: Path, key: str) -> NDArray[Any]:
    with zipfile.ZipFile(path) as archive, archive.open(f"{key}.npy") as stream:
        values = load_array(stream)
        stream.read(1)  # reaching the end makes zipfile compare the checksum
        return values
