"""Reading pictures: one PNG, TIFF (of one page or many), BMP or PGM, or a folder of them, as one array without a name.

Numbers are taken as they are stored: 8 or 16 bits, or floating point.
"""

import math
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ArrayEntry, Container, damage_as_input_error
from gs2ci.core.limits import LIMIT_BYTES

# TIFF 6.0 and BigTIFF, each in both orders of bytes: how numbers, links, counts of entries are packed, bytes per entry.
_TIFF: Final = {
    b"II*\0": ("<I", "<H", 12),
    b"MM\0*": (">I", ">H", 12),
    b"II+\0": ("<Q", "<Q", 20),
    b"MM\0+": (">Q", ">Q", 20),
}
SIGNATURES: Final = (b"\x89PNG\r\n\x1a\n", *_TIFF, b"BM", b"P5")
JPEG: Final = b"\xff\xd8\xff"


def is_picture(start: bytes) -> bool:
    """Tell whether a file that begins so is a picture."""
    return start.startswith((*SIGNATURES, JPEG))


def read_pictures(path: Path) -> Container:
    """Open a picture, or all pictures of a folder in the order of the numbers in their names.

    Raises:
        InputError: There is none, they differ in size or kind, one is damaged, incomplete, a JPEG or partly
            transparent.
    """
    files = _in_folder(path) if path.is_dir() else [path]
    pages: list[NDArray[Any]] = []
    for file in files:
        found = _pages(file)
        pages += found
        for number, page in enumerate(found, 1):
            if page.shape != pages[0].shape or page.dtype != pages[0].dtype:
                raise InputError(
                    f"{file}{f', page {number}' if len(found) > 1 else ''}: {_kind(page)}, "
                    f"but {files[0].name} has {_kind(pages[0])}",
                    allowed="pictures of one size and kind",
                    remedy="take out what does not belong there",
                )
        if sum(page.nbytes for page in pages) > LIMIT_BYTES:
            raise InputError(f"{path}: more than {LIMIT_BYTES} bytes of pictures", remedy="take fewer, or cut them")
    # Programs save grey pictures as colour ones; three equal channels say nothing that one does not.
    if pages[0].ndim == 3 and all((page == page[..., :1]).all() for page in pages):
        pages = [page[..., 0] for page in pages]
    values = pages[0] if not path.is_dir() and len(pages) == 1 else np.stack(pages)
    order = f"{len(files)} pictures, {files[0].name} to {files[-1].name}" if len(files) > 1 else ""
    return Container(path, {"": ArrayEntry(values.shape, "number")}, lambda key: values, note=order)


def _in_folder(folder: Path) -> list[Path]:
    """List a folder's pictures so that mask10.png follows mask9.png; other files are passed over."""
    with damage_as_input_error(str(folder)):
        files = [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]
        files = [file for file in files if is_picture(_start(file))]
    if not files:
        raise InputError(f"{folder}: no picture in this folder", allowed="PNG, TIFF, BMP or PGM")
    return sorted(files, key=lambda file: [(int(part), "") if part.isdecimal() else (0, part) for part in _parts(file)])


def _parts(file: Path) -> list[str]:
    """Split a name so that its numbers stand at the odd places."""
    return re.split(r"([0-9]+)", file.name)


def _start(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(16)


def _pages(file: Path) -> list[NDArray[Any]]:
    """Decode a file's pages, [H, W] or [H, W, 3] in the order red, green, blue."""
    if _start(file).startswith(JPEG):
        raise InputError(
            f"{file}: a JPEG, whose numbers are neither exact nor proportional to light",
            allowed="PNG, TIFF, BMP or PGM",
            remedy="save the camera's readings as 16-bit PNG or TIFF",
        )
    with damage_as_input_error(str(file)), _silence():
        stored = np.fromfile(file, np.uint8)
        found, pages = cv2.imdecodemulti(stored, cv2.IMREAD_UNCHANGED)
        if not found or not all(math.prod(page.shape) for page in pages):
            raise InputError(f"{file}: no picture can be read in it", remedy="save it again as PNG or TIFF")
        # OpenCV leaves out, without a word, the pages from the first one on that it cannot read.
        if len(pages) < _pages_named(stored.data):
            raise InputError(
                f"{file}: {len(pages)} page(s) can be read, but its list of pages does not end there",
                allowed="a whole file",
                remedy="it was cut off or is damaged: copy it or save it again",
            )
    return [_in_order(file, np.asarray(page)) for page in pages]


def _pages_named(stored: memoryview) -> int:
    """Count the pages that a TIFF's chain of directories names, and one more where the chain leads out of the file.

    Each directory is a count of entries, the entries, and the link to the next directory, 0 after the last one; the
    first link is the last field of the header. Other kinds of files name none.
    """
    link, count, entry_bytes = _TIFF.get(bytes(stored[:4]), ("", "", 0))
    if not link:
        return 0
    places: set[int] = set()
    at = struct.calcsize(link)
    try:
        while place := struct.unpack_from(link, stored, at)[0]:
            (entries,) = struct.unpack_from(count, stored, place)
            if place in places:
                break
            places.add(place)
            at = place + struct.calcsize(count) + entries * entry_bytes
    except (struct.error, OverflowError):
        return len(places) + 1
    return len(places)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep OpenCV from printing what it thinks of a damaged picture; the error that is raised says it."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _in_order(file: Path, page: NDArray[Any]) -> NDArray[Any]:
    """Turn OpenCV's blue, green, red, opacity round, and leave out an opacity that is full everywhere."""
    if page.ndim == 3 and page.shape[2] == 4:
        if (page[..., 3] != page[..., 3].max()).any():
            raise InputError(f"{file}: a picture that is partly transparent", remedy="save it without transparency")
        page = page[..., :3]
    return page[..., ::-1] if page.ndim == 3 else page


def _kind(page: NDArray[Any]) -> str:
    channels = f" x {page.shape[2]}" if page.ndim == 3 else ""
    return f"{page.shape[0]} x {page.shape[1]}{channels} pixels of {page.dtype}"
