"""Reading pictures: one PNG, TIFF (of one page or many), BMP or PGM, or a folder of them, as one array without a name.

Numbers are taken as they are stored: 8 or 16 bits, or floating point.
"""

import math
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.container import ArrayEntry, Container, damage_as_input_error
from gs2ci.core.limits import LIMIT_BYTES
from gs2ci.core.natural_order import natural_order

# TIFF 6.0 and BigTIFF, each in both orders of bytes: how numbers, links, counts of entries are packed, bytes per entry.
_TIFF: Final = {
    b"II*\0": ("<I", "<H", 12),
    b"MM\0*": (">I", ">H", 12),
    b"II+\0": ("<Q", "<Q", 20),
    b"MM\0+": (">Q", ">Q", 20),
}
# Numbers of tags: 0 as white or black, and whether the colours lie side by side (1) or in separate planes (2).
_PHOTOMETRIC, _PLANES = _LAYOUT = (262, 284)
# What ImageJ and tifffile write in a description: the number of images, or the shape of the whole array.
_COUNT: Final = re.compile(rb"ImageJ=[^\0]*?\simages=(\d+)|\{\"shape\": \[([\d, ]+)\]")
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
    if natural_order([file.name for file in files]).is_doubtful:
        order += "; WARNING: whole numbers decide, 0.5 before 0.25: rename them if theirs are decimal numbers"
    return Container(path, {"": ArrayEntry(values.shape, "number")}, lambda key: values, note=order)


def _in_folder(folder: Path) -> list[Path]:
    """List a folder's pictures so that mask10.png follows mask9.png; files with other endings are passed over.

    Raises:
        InputError: There is none, or a file that is none has the ending of one, such as a picture that was cut to 0
            bytes: without it every later mask would stand in another's place.
    """
    with damage_as_input_error(str(folder)):
        there = [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]
        files = [file for file in there if is_picture(_start(file))]
    if not files:
        raise InputError(f"{folder}: no picture in this folder", allowed="PNG, TIFF, BMP or PGM")
    endings = {file.suffix.lower() for file in files}
    for file in sorted(set(there) - set(files)):
        if file.suffix.lower() in endings:
            raise InputError(
                f"{file}: no picture, though its name ends as theirs do",
                allowed="PNG, TIFF, BMP or PGM",
                remedy="it is empty, damaged or of another kind: copy it or save it again, or take it out",
            )
    return [files[index] for index in natural_order([file.name for file in files]).indices]


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
        layouts = _layouts(stored.data)
        # OpenCV leaves out, without a word, the pages from the first one on that it cannot read.
        if len(pages) < len(layouts):
            raise InputError(
                f"{file}: {len(pages)} page(s) can be read, but its list of pages does not end there",
                allowed="a whole file",
                remedy="it was cut off or is damaged: copy it or save it again",
            )
        # A stack may have one page in the list, whose description counts those that lie behind it.
        described = _described(stored.data, pages[0].size) if layouts else 0
        if len(pages) < described:
            raise InputError(
                f"{file}: its description counts {described} images, but its list has {len(pages)} page(s)",
                allowed="a TIFF that lists every page",
                remedy="save it as single pictures in a folder, as .npy, or page by page (tifffile: truncate=False)",
            )
        for page, layout in zip(pages, layouts, strict=False):
            _check_layout(file, np.asarray(page), layout)
    return [_in_order(file, np.asarray(page)) for page in pages]


def _check_layout(file: Path, page: NDArray[Any], layout: Mapping[int, int]) -> None:
    """Refuse what OpenCV mixes up without a word if a number has more than 8 bits.

    Raises:
        InputError: The colours lie in separate planes, which it reads as if they lay side by side; or 0 is white,
            which it ignores.
    """
    if page.dtype == np.uint8:
        return
    if page.ndim == 3 and layout.get(_PLANES, 1) != 1:
        raise InputError(
            f"{file}: a TIFF of {page.dtype} whose colours lie in separate planes",
            allowed="the colours of a pixel side by side, or one page for each mask",
            remedy='save it again as [H, W, 3]; masks page by page (tifffile: photometric="minisblack"); or as .npy',
        )
    if page.ndim == 2 and layout.get(_PHOTOMETRIC, 1) == 0:
        raise InputError(
            f"{file}: a TIFF of {page.dtype} that counts from white, so that 0 is the brightest",
            allowed="numbers that grow with the light (photometric interpretation: black is zero)",
            remedy="invert it and save it again, or as .npy",
        )


def _layouts(stored: memoryview) -> list[dict[int, int]]:
    """Return how the numbers of each page lie that a TIFF's chain of directories names, by the tags `_LAYOUT`.

    One more, empty, where the chain leads out of the file. Each directory is a count of entries, the entries (tag,
    type, count, value), and the link to the next directory, 0 after the last one; the first link is the last field of
    the header. Other kinds of files name none.
    """
    link, count, entry_bytes = _TIFF.get(bytes(stored[:4]), ("", "", 0))
    if not link:
        return []
    found: dict[int, dict[int, int]] = {}
    at = struct.calcsize(link)
    short, value_at = link[0] + "H", entry_bytes - struct.calcsize(link)
    try:
        while place := struct.unpack_from(link, stored, at)[0]:
            (entries,) = struct.unpack_from(count, stored, place)
            if place in found:
                break
            first = place + struct.calcsize(count)
            at = first + entries * entry_bytes
            found[place] = {}
            struct.unpack_from(link, stored, at)
            starts = range(first, at, entry_bytes)
            tags = {struct.unpack_from(short, stored, start)[0]: start for start in starts}
            found[place] = {
                tag: struct.unpack_from(short, stored, tags[tag] + value_at)[0] for tag in _LAYOUT if tag in tags
            }
    except (struct.error, OverflowError):
        return [*found.values(), {}]
    return list(found.values())


def _described(stored: memoryview, page_size: int) -> int:
    """Return how many pages of `page_size` numbers a TIFF's description counts; 0 if it counts none."""
    found = _COUNT.search(stored)
    if found is None:
        return 0
    images, shape = found.groups()
    return int(images) if images else math.prod(int(side) for side in shape.split(b",")) // page_size


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
