"""A look at an HDF5 file's text storage before the library reads it.

Variable-length texts lie in «global heaps». The library walks a heap from object to object by the sizes it finds
there, and a damaged size of zero keeps it walking for ever (HDF5 2.0.0, `H5HG__cache_heap_deserialize`): seen on a
capture file with eight changed bytes. So heaps are walked here first. Anyone in core may import this file.
"""

import mmap
import struct
from pathlib import Path

# Format specification, section III.E: signature, version 1, three zeros, size; then objects of index, count, four
# zeros and size; object 0 is the free rest.
_SIGNATURE = b"GCOL\x01\x00\x00\x00"
_HEADER_BYTES = 16


def check_text_heaps(path: Path) -> None:
    """Return if every global heap of a file can be walked to its end.

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
