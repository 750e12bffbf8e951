"""A capture file whose end is missing, read as if its end were zeros.

HDF5 stores the length of a file in its superblock and does not open a shorter file. A failed write leaves such a file,
although every row that was marked as complete lies before the missing end.

Here: `stored_end` and `PaddedFile`, for `recover`, and `row_end`, which finds rows that lie in the missing end: zeros
there would pass their checksum, which is zero, too. The damaged file is not changed. Not here: what is read.
Source: HDF5 File Format Specification 3.0, section II.A, superblock versions 0 to 3.
"""

import os
import struct
from pathlib import Path
from typing import Final

import h5py

from gs2ci.core.storage.sized_file import SizedFile

_SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
# Version -> where it states the size of an offset, and behind how many bytes plus how many offsets the end of file
# stands: versions 0 and 1 after base and free space, 2 and 3 after base and extension.
_LAYOUTS: Final = {0: (13, 24, 2), 1: (13, 28, 2), 2: (9, 12, 2), 3: (9, 12, 2)}


def stored_end(path: Path) -> int | None:
    """Return how long a file says that it is, byte; None where it does not say so in a way known here.

    Raises:
        OSError: The file cannot be read.
    """
    with path.open("rb") as stream:
        head = stream.read(64)
    if len(head) < 64 or not head.startswith(_SIGNATURE) or head[8] not in _LAYOUTS:
        return None
    width_at, start, before = _LAYOUTS[head[8]]
    if head[width_at] != 8:
        return None
    return int(struct.unpack_from("<Q", head, start + 8 * before)[0])


def row_end(dataset: h5py.Dataset, row: int) -> int:
    """Return where in the file the last byte of a row's data ends; 0 where none were stored.

    Args:
        dataset: Rows along its first axis, one row or part of it in a chunk, or in one piece.
        row: Which, from 0.
    """
    if dataset.chunks is None:
        start = dataset.id.get_offset()
        return 0 if start is None else int(start) + (row + 1) * (dataset.id.get_storage_size() // dataset.shape[0])
    ends = [0]
    for at in range(0, dataset.shape[1] if dataset.ndim > 1 else 1, dataset.chunks[1] if dataset.ndim > 1 else 1):
        chunk = dataset.id.get_chunk_info_by_coord((row, at, *(0,) * (dataset.ndim - 2))[: dataset.ndim])
        if chunk.byte_offset is not None:
            ends.append(int(chunk.byte_offset) + int(chunk.size))
    return max(ends)


class PaddedFile(SizedFile):
    """A file that is read as if it were `size_bytes` long, zeros after its own end. Reading only.

    Raises:
        OSError: The file cannot be opened.
    """

    def __init__(self, path: Path, size_bytes: int) -> None:
        super().__init__(os.open(path, os.O_RDONLY | os.O_CLOEXEC), size_bytes)
