"""What the tags of a TIFF say about its numbers, and what a decoder does to them without a word.

OpenCV stretches 10, 12 and 14 bits to 16, maps colours, undoes lossy compression and turns pictures by their tag of
orientation. Here the tags are read first: what can be taken back is, what cannot is refused by name.
"""

import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError

# TIFF 6.0 and BigTIFF, each in both orders of bytes: how numbers, links, counts of entries are packed, bytes per entry.
KINDS: Final = {
    b"II*\0": ("<I", "<H", 12),
    b"MM\0*": (">I", ">H", 12),
    b"II+\0": ("<Q", "<Q", 20),
    b"MM\0+": (">Q", ">Q", 20),
}
# What ImageJ and tifffile write in a description: the number of images, or the shape of the whole array.
_COUNT: Final = re.compile(rb"ImageJ=[^\0]*?\simages=(\d+)|\{\"shape\": \[([\d, ]+)\]")
# ImageJ keeps signed numbers of 16 bits as such without a sign, and a calibration that says so.
SIGNED: Final = re.compile(rb"ImageJ=[^\0]*?\sc0=-32768[.\d]*\s+c1=1(?:\.0*)?\s")
# Numbers of tags (TIFF 6.0; GDAL and DNG 1.4 for the last two): kind of page (odd: a reduced copy), bits per number,
# compression, 0 as white or black, orientation, numbers of a pixel, these side by side (1) or in planes (2), kind of
# number, the text of the number that stands where there is none, version of DNG.
TAGS = 254, 258, 259, 262, 274, 277, 284, 339, 42113, 50706
PAGE, BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION, BANDS, PLANES, KIND, NO_DATA, DNG = TAGS
_TEXT: Final = 2
_SHORT: Final = 3
_ALLOWED: Final = "a TIFF of 8 to 16 bits, whole numbers of 32 or floating point of 32 or 64, lossless"
_PLAIN: Final = "save it again as 16-bit TIFF or PNG"
_COMPRESSIONS: Final = {
    6: "compressed as JPEG, so that its numbers are neither exact nor proportional to light",
    7: "compressed as JPEG, so that its numbers are neither exact nor proportional to light",
    34712: "compressed as JPEG 2000",
    33003: "compressed as JPEG 2000",
    33005: "compressed as JPEG 2000",
    34892: "compressed as lossy JPEG",
    50000: "compressed by Zstandard",
    34926: "compressed by Zstandard",
    34925: "compressed by LZMA",
    50001: "compressed as WebP",
    50002: "compressed as JPEG XL",
    52546: "compressed as JPEG XL",
    34887: "compressed by LERC",
}
_PHOTOMETRICS: Final = {
    3: "a palette, so that its numbers are names of colours",
    5: "inks (CMYK)",
    6: "brightness and colour differences (YCbCr)",
    8: "CIE L*a*b*",
    32803: "a camera's raw mosaic",
    34892: "a camera's linear raw data",
}
_FLOATING: Final = 3
# Colours and an opacity.
_MOST_BANDS: Final = 4
# Turned by their tag: 1 is upright.
_UPRIGHT: Final = 1


def layouts(stored: memoryview) -> list[dict[int, int]]:
    """Return how the numbers of each page lie that a TIFF's chain of directories names, by the tags `TAGS`.

    One more, empty, where the chain leads out of the file. Each directory is a count of entries, the entries (tag,
    type, count, value), and the link to the next directory, 0 after the last one; the first link is the last field of
    the header. Other kinds of files name none.
    """
    link, count, entry_bytes = KINDS.get(bytes(stored[:4]), ("", "", 0))
    if not link:
        return []
    found: dict[int, dict[int, int]] = {}
    at = struct.calcsize(link)
    short = link[0] + "H"
    try:
        while place := struct.unpack_from(link, stored, at)[0]:
            (entries,) = struct.unpack_from(count, stored, place)
            if place in found:
                break
            first = place + struct.calcsize(count)
            at = first + entries * entry_bytes
            found[place] = {}
            struct.unpack_from(link, stored, at)
            for start in range(first, at, entry_bytes):
                (tag,) = struct.unpack_from(short, stored, start)
                if tag in TAGS:
                    found[place][tag] = _first_value(stored, start, link)
    except (struct.error, OverflowError):
        return [*found.values(), {}]
    return list(found.values())


def _first_value(stored: memoryview, start: int, link: str) -> int:
    """Return the first number of an entry: in it, or, if there are too many, where it points; of a text, its place."""
    order, room = link[0], struct.calcsize(link)
    (kind,) = struct.unpack_from(order + "H", stored, start + 2)
    (many,) = struct.unpack_from(link, stored, start + 4)
    at, step = start + 4 + room, {1: "B", _TEXT: "B", _SHORT: "H"}.get(kind, "I")
    if many * struct.calcsize(step) > room:
        (at,) = struct.unpack_from(link, stored, at)
    return at if kind == _TEXT else int(struct.unpack_from(order + step, stored, at)[0])


def described(stored: memoryview, page_size: int) -> int:
    """Return how many pages of `page_size` numbers a TIFF's description counts; 0 if it counts none."""
    found = _COUNT.search(stored)
    if found is None:
        return 0
    images, shape = found.groups()
    return int(images) if images else math.prod(int(side) for side in shape.split(b",")) // page_size


def _of_a_camera(file: Path) -> InputError:
    return InputError(
        f"{file}: a DNG or another raw file of a camera, which is not read",
        allowed=_ALLOWED,
        remedy="convert it without development: `dcraw -4 -D -T FILE` (or unprocessed_raw -T of LibRaw), and say "
        "--cfa and --offset, its black level",
    )


def refuse(file: Path, layout: Mapping[int, int]) -> None:
    """Refuse, before it is decoded, what OpenCV decodes to other numbers or not at all.

    Raises:
        InputError: A DNG, a lossy or unknown compression, or numbers that are no light.
    """
    photometric = _PHOTOMETRICS.get(layout.get(PHOTOMETRIC, 1))
    if DNG in layout or layout.get(PHOTOMETRIC) in (32803, 34892):
        raise _of_a_camera(file)
    words = _COMPRESSIONS.get(layout.get(COMPRESSION, 1)) or photometric
    if words is None and layout.get(BITS, 1) in (2, 3, 4, 5, 6, 7):
        words = f"of {layout[BITS]} bits"
    if words is None and layout.get(KIND) == _FLOATING and layout.get(BITS, 32) < 32:
        words = f"of floating point of {layout[BITS]} bits"
    if words is not None:
        raise InputError(f"{file}: a TIFF, {words}", allowed=_ALLOWED, remedy=_PLAIN)
    if layout.get(BANDS, 1) > _MOST_BANDS:
        raise InputError(
            f"{file}: a TIFF of {layout[BANDS]} numbers for each pixel, as GDAL's bands are",
            allowed="one page for each mask, of one number for each pixel, or of three for its colours",
            remedy='save the bands as pages (tifffile: photometric="minisblack"), or as .npy',
        )


def whole(file: Path, layouts: list[dict[int, int]]) -> list[int]:
    """Return the numbers of the pages that are no reduced copies.

    Raises:
        InputError: All are, as in a camera's raw file, which keeps its picture beside the list of pages.
    """
    kept = [number for number, layout in enumerate(layouts) if not layout.get(PAGE, 0) & 1]
    if layouts and not kept:
        raise _of_a_camera(file)
    return kept


def check(file: Path, page: NDArray[Any], layout: Mapping[int, int]) -> None:
    """Refuse what OpenCV mixes up without a word if a number has more than 8 bits.

    Raises:
        InputError: The colours lie in separate planes, which it reads as if they lay side by side; or 0 is white,
            which it ignores.
    """
    if page.dtype == np.uint8:
        return
    if page.ndim == 3 and layout.get(PLANES, 1) != 1:
        raise InputError(
            f"{file}: a TIFF of {page.dtype} whose colours lie in separate planes",
            allowed="the colours of a pixel side by side, or one page for each mask",
            remedy='save it again as [H, W, 3]; masks page by page (tifffile: photometric="minisblack"); or as .npy',
        )
    if page.ndim == 2 and layout.get(PHOTOMETRIC, 1) == 0:
        raise InputError(
            f"{file}: a TIFF of {page.dtype} that counts from white, so that 0 is the brightest",
            allowed="numbers that grow with the light (photometric interpretation: black is zero)",
            remedy="invert it and save it again, or as .npy",
        )


def booleans(stored: memoryview, layouts: list[dict[int, int]]) -> list[bool]:
    """Tell which pages tifffile wrote from boolean arrays: of one bit, whose tag says that 0 is white.

    tifffile (2026.3.3) gives booleans that tag by itself and does not look at it when it reads them; who follows the
    tag sees open elements closed. It is known by its description, `{"shape": …}`.
    """
    count = _COUNT.search(stored)
    of_tifffile = count is not None and count[2] is not None
    return [of_tifffile and layout.get(BITS, 1) == 1 and layout.get(PHOTOMETRIC) == 0 for layout in layouts]


def as_stored(file: Path, page: NDArray[Any], layout: Mapping[int, int], *, is_boolean: bool) -> NDArray[Any]:
    """Take back the stretching of 9 to 15 bits to 16, and the inversion of booleans (0 and 255, of 8 bits).

    Raises:
        InputError: The page was not stretched by a shift of its bits.
    """
    if is_boolean:
        return 255 - page
    bits = layout.get(BITS, 16)
    if page.dtype != np.uint16 or not 8 < bits < 16:
        return page
    shift = 16 - bits
    if (page & (2**shift - 1)).any():
        raise InputError(
            f"{file}: a TIFF of {bits} bits that is decoded to other numbers", allowed=_ALLOWED, remedy=_PLAIN
        )
    return page >> shift


def lacking(stored: memoryview, page: NDArray[Any], layout: Mapping[int, int]) -> tuple[NDArray[Any], str]:
    """Put NaN where a page holds the number that GDAL's tag names for want of one, and say so; 0 is dark, and a number.

    Raises:
        ValueError: The tag holds no number.
    """
    if NO_DATA not in layout:
        return page, ""
    place = layout[NO_DATA]
    absent = float(bytes(stored[place : place + 64]).split(b"\0")[0])
    none = page == (page.dtype.type(absent) if page.dtype.kind == "f" else absent)
    if absent == 0 or not none.any():
        return page, ""
    return np.where(none, np.nan, page), f"{absent:.6g} stands where there is no number, as its tag of GDAL's says"


def note_of(layout: Mapping[int, int], *, is_boolean: bool) -> str:
    """Say what was done to a page."""
    notes = []
    bits = layout.get(BITS, 16)
    if 8 < bits < 16:
        notes.append(f"{bits} bits")
    if is_boolean:
        notes.append("true is 1, though its tag says that 0 is white, as in all boolean arrays that tifffile writes")
    elif layout.get(PHOTOMETRIC, 1) == 0:
        notes.append("0 is white, as its tag says")
    turned = layout.get(ORIENTATION, _UPRIGHT)
    if turned != _UPRIGHT:
        notes.append(f"turned as its tag of orientation says ({turned})")
    return ", ".join(notes)
