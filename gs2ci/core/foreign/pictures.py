"""Reading pictures: one PNG, TIFF (of one page or many), BMP or PGM, or a folder of them, as one array without a name.

Numbers are taken as they are stored, whatever a decoder makes of them (`tiff`).
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.foreign import tiff
from gs2ci.core.foreign.container import ArrayEntry, Container, damage_as_input_error
from gs2ci.core.limits import LIMIT_BYTES
from gs2ci.core.natural_order import natural_order

SIGNATURES: Final = (b"\x89PNG\r\n\x1a\n", *tiff.KINDS, b"BM", b"P5")
# From so many on, the names of pictures show which one is of another kind.
_COMPANY: Final = 4
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
    notes: set[str] = set()
    for file in files:
        found, note = _pages(file)
        notes |= {note} if note else set()
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
    elif len(files) > 1 and not any(digit in file.stem for digit in "0123456789" for file in files):
        order += "; WARNING: in the order of the alphabet, since their names hold no numbers"
    return Container(
        path,
        {"": ArrayEntry(values.shape, "number")},
        lambda key: values,
        note="; ".join([order, *sorted(notes)] if order else sorted(notes)),
        pages=len(pages),
    )


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
        held = f"; it holds {len(there)} files, such as {min(there).name}" if there else ""
        raise InputError(
            f"{folder}: no picture in this folder{held}",
            allowed="PNG, TIFF, BMP or PGM",
            remedy="name the file itself, or stack the masks: np.save('masks.npy', np.stack([...]))",
        )
    _check_company(folder, files)
    endings = {file.suffix.lower() for file in files}
    for file in sorted(set(there) - set(files)):
        if file.suffix.lower() in endings:
            raise InputError(
                f"{file}: no picture, though its name ends as theirs do",
                allowed="PNG, TIFF, BMP or PGM",
                remedy="it is empty, damaged or of another kind: copy it or save it again, or take it out",
            )
    return [files[index] for index in natural_order([file.name for file in files]).indices]


def _check_company(folder: Path, files: list[Path]) -> None:
    """Refuse a picture whose name has nothing of that which all others share but their numbers.

    Raises:
        InputError: There is one; a measurement among its masks would be taken for another mask.
    """
    words = [re.sub(r"\d+", "#", file.stem.lower()) for file in files]
    shared = max(set(words), key=words.count)
    odd = [file for file, word in zip(files, words, strict=True) if word != shared]
    if len(files) >= _COMPANY and len(odd) == 1 and "#" in shared and not odd[0].stem[-1].isdigit():
        raise InputError(
            f"{folder}: {odd[0].name} beside {len(files) - 1} pictures whose names differ in numbers alone",
            allowed="the masks, or the frames of one stack, and no other picture",
            remedy=f"take {odd[0].name} out if it is no mask; if it is one, rename it as the others",
        )


def _start(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(16)


def _pages(file: Path) -> tuple[list[NDArray[Any]], str]:
    """Decode a file's pages, [H, W] or [H, W, 3] in the order red, green, blue; and say what was done to them."""
    if _start(file).startswith(JPEG):
        raise InputError(
            f"{file}: a JPEG, whose numbers are neither exact nor proportional to light",
            allowed="PNG, TIFF, BMP or PGM",
            remedy="save the camera's readings as 16-bit PNG or TIFF",
        )
    # A bench reads its patterns from arrays, without OpenCV.
    import cv2  # noqa: PLC0415

    with damage_as_input_error(str(file)), _silence(cv2.utils.logging):
        stored = np.fromfile(file, np.uint8)
        layouts = tiff.layouts(stored.data)
        kept = tiff.whole(file, layouts)
        for number in kept:
            tiff.refuse(file, layouts[number])
        found, pages = cv2.imdecodemulti(stored, cv2.IMREAD_UNCHANGED)
        if not found or not all(math.prod(page.shape) for page in pages):
            raise InputError(f"{file}: no picture can be read in it", remedy="save it again as PNG or TIFF")
        # OpenCV leaves out, without a word, the pages from the first one on that it cannot read.
        if len(pages) < len(layouts):
            raise InputError(
                f"{file}: {len(pages)} page(s) can be read, but its list of pages does not end there",
                allowed="a whole file",
                remedy="it was cut off or is damaged: copy it or save it again",
            )
        # A stack may have one page in the list, whose description counts those that lie behind it.
        described = tiff.described(stored.data, pages[0].size) if layouts else 0
        if len(pages) < described:
            raise InputError(
                f"{file}: its description counts {described} images, but its list has {len(pages)} page(s)",
                allowed="a TIFF that lists every page",
                remedy="save it as single pictures in a folder, as .npy, or page by page (tifffile: truncate=False)",
            )
        notes: set[str] = set()
        if layouts and len(kept) < len(layouts):
            notes.add(f"{len(layouts) - len(kept)} reduced copies among its pages: left out")
            pages, layouts = [pages[number] for number in kept], [layouts[number] for number in kept]
        read = [np.asarray(page) for page in pages]
        for number, (layout, is_boolean) in enumerate(zip(layouts, tiff.booleans(stored.data, layouts), strict=True)):
            tiff.check(file, read[number], layout)
            read[number] = tiff.as_stored(file, read[number], layout, is_boolean=is_boolean)
            read[number], note = tiff.lacking(stored.data, read[number], layout)
            notes |= {tiff.note_of(layout, is_boolean=is_boolean), note}
        if tiff.SIGNED.search(stored.data) and read[0].dtype == np.uint16:
            read = [page.astype(np.int32) - 2**15 for page in read]
            notes.add("numbers with a sign, 32768 less than stored, as ImageJ's calibration says")
    return [_in_order(file, page) for page in read], "; ".join(sorted(notes - {""}))


@contextmanager
def _silence(logging: Any) -> Iterator[None]:
    """Keep OpenCV from printing what it thinks of a damaged picture; the error that is raised says it."""
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def _in_order(file: Path, page: NDArray[Any]) -> NDArray[Any]:
    """Turn OpenCV's blue, green, red, opacity round, and leave out an opacity that is full everywhere."""
    if page.ndim == 3 and page.shape[2] == 4:
        if (page[..., 3] != page[..., 3].max()).any():
            raise InputError(
                f"{file}: a picture that is partly transparent",
                remedy="save it without transparency; four masks page by page (tifffile: photometric='minisblack')",
            )
        page = page[..., :3]
    return page[..., ::-1] if page.ndim == 3 else page


def _kind(page: NDArray[Any]) -> str:
    channels = f" x {page.shape[2]}" if page.ndim == 3 else ""
    return f"{page.shape[0]} x {page.shape[1]}{channels} pixels of {page.dtype}"
