"""Pixel formats of GenICam cameras by their names, and their unpacking to u16; pure numpy.

The names and layouts are those of the Pixel Format Naming Convention (EMVA, PFNC 2.4, sections 4 and 6):

    Mono12        16-bit little-endian words, the value in the low bits
    Mono12p       values one after another in a stream of bits, lowest bit first: 2 pixels in 3 bytes
    Mono12Packed  GigE Vision 1.x: the high bytes of two pixels, between them one byte with the low bits of both

Here: what a name means, and `unpack_pfnc`. Not here: V4L2's four-character codes (`gs2ci_drivers.v4l2.formats`), colour
formats that a camera has interpolated itself, which are no raw readings.
"""

import enum
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern


class PixelLayout(enum.Enum):
    """How the values of neighbouring pixels lie in memory."""

    BYTES = "bytes"
    WORDS = "words"
    STREAM = "p"
    """PFNC's suffix "p": a stream of bits, lowest first."""
    GROUPED = "Packed"
    """GigE Vision's suffix "Packed": three bytes for two pixels."""


@dataclass(frozen=True)
class PfncFormat:
    """What a name means.

    Args:
        name: Name in the camera's feature PixelFormat.
        bits: Significant bits of a pixel.
        layout: How values lie in memory.
        cfa: Colour filter array, None for mono.
    """

    name: str
    bits: int
    layout: PixelLayout
    cfa: CfaPattern | None = None

    @property
    def bits_in_memory(self) -> int:
        """Get how many bits a pixel takes."""
        return {PixelLayout.BYTES: 8, PixelLayout.WORDS: 16, PixelLayout.STREAM: self.bits, PixelLayout.GROUPED: 12}[
            self.layout
        ]

    @property
    def top(self) -> int:
        """Get the largest value."""
        return (1 << self.bits) - 1

    def payload_bytes(self, height: int, width: int, padding_bytes: int = 0) -> int:
        """Compute how many bytes an image takes; without padding, rows follow each other in the same stream of bits."""
        if padding_bytes:
            return height * (self._bytes(width) + padding_bytes) - padding_bytes
        return self._bytes(height * width)

    def _bytes(self, pixels: int) -> int:
        if self.layout is PixelLayout.GROUPED:
            return math.ceil(pixels / 2) * 3
        return math.ceil(pixels * self.bits_in_memory / 8)


_CFAS: Final[dict[str, CfaPattern]] = {"BG": "BGGR", "GB": "GBRG", "GR": "GRBG", "RG": "RGGB"}


def _formats() -> dict[str, PfncFormat]:
    found = []
    kinds: list[tuple[str, CfaPattern | None]] = [("Mono", None), *((f"Bayer{key}", cfa) for key, cfa in _CFAS.items())]
    for name, cfa in kinds:
        found.append(PfncFormat(f"{name}8", 8, PixelLayout.BYTES, cfa))
        found += [PfncFormat(f"{name}{bits}", bits, PixelLayout.WORDS, cfa) for bits in (10, 12, 14, 16)]
        found += [PfncFormat(f"{name}{bits}p", bits, PixelLayout.STREAM, cfa) for bits in (10, 12, 14)]
        found += [PfncFormat(f"{name}{bits}Packed", bits, PixelLayout.GROUPED, cfa) for bits in (10, 12)]
    return {one.name: one for one in found}


PFNC_FORMATS: Final = _formats()


def unpack_pfnc(data: bytes, form: PfncFormat, height: int, width: int, padding_bytes: int = 0) -> U16:
    """Unpack the bytes of an image.

    Args:
        data: At least `form.payload_bytes` bytes, rows top-down.
        form: What the pixels are.
        height: Rows.
        width: Columns.
        padding_bytes: Bytes after each row that do not belong to the image.

    Returns:
        Pixels, [H, W] uint16 in [0, form.top]; a copy.

    Raises:
        InputError: A size below 1, too few bytes, or a value that the format cannot have.
    """
    if height < 1 or width < 1:
        raise InputError(f"an image of {width} x {height} pixels", allowed="at least 1 x 1")
    needed = form.payload_bytes(height, width, padding_bytes)
    if len(data) < needed:
        raise InputError(
            f"{len(data)} bytes for {width} x {height} {form.name}",
            allowed=f"at least {needed}",
            remedy="drop the frame; it was cut short",
        )
    if padding_bytes:
        row = needed // height if height == 1 else (needed + padding_bytes) // height
        raw = np.frombuffer(data.ljust(row * height, b"\0"), np.uint8, row * height).reshape(height, row)
        values = _values(raw, form, width)
    else:
        values = _values(np.frombuffer(data, np.uint8, needed)[None], form, height * width).reshape(height, width)
    largest = int(values.max())
    if largest > form.top:
        raise InputError(
            f"a {form.name} pixel reads {largest}",
            allowed=f"0 to {form.top}",
            remedy="the camera aligns its values to the high bits: choose Mono16, or a packed format",
        )
    return values


def _values(rows: U8, form: PfncFormat, count: int) -> U16:
    """Return the first `count` values of each row of bytes, [R, count]."""
    if form.layout is PixelLayout.BYTES:
        return rows[:, :count].astype(np.uint16)
    if form.layout is PixelLayout.WORDS:
        return np.ascontiguousarray(rows[:, : 2 * count]).view("<u2").astype(np.uint16)
    if form.layout is PixelLayout.GROUPED:
        return _grouped(_in_groups(rows, 3), form.bits)[:, :count]
    group = math.lcm(form.bits, 8) // 8
    return _stream(_in_groups(rows, group), form.bits)[:, :count]


def _in_groups(rows: U8, size: int) -> U8:
    """Cut rows into groups of `size` bytes, the last one padded with zeros, [R, G, size]."""
    groups = math.ceil(rows.shape[1] / size)
    if groups * size != rows.shape[1]:
        rows = np.pad(rows, ((0, 0), (0, groups * size - rows.shape[1])))
    return rows.reshape(len(rows), groups, size)


def _stream(groups: U8, bits: int) -> U16:
    """Read values of `bits` bits, the lowest bit first, from groups that begin with a whole value."""
    size = groups.shape[2]
    out = np.empty((*groups.shape[:2], size * 8 // bits), np.uint16)
    for i in range(out.shape[2]):
        first, shift = divmod(i * bits, 8)
        word = np.zeros(groups.shape[:2], np.uint32)
        for k in range(first, min(first + 3, size)):
            word |= groups[:, :, k].astype(np.uint32) << np.uint32(8 * (k - first))
        out[:, :, i] = (word >> np.uint32(shift)) & np.uint32((1 << bits) - 1)
    return out.reshape(len(groups), -1)


def _grouped(groups: U8, bits: int) -> U16:
    """Read two values from three bytes: high bits of one, low bits of both, high bits of the other."""
    low, mask = bits - 8, np.uint16((1 << (bits - 8)) - 1)
    high = groups.astype(np.uint16)
    out = np.empty((*groups.shape[:2], 2), np.uint16)
    out[:, :, 0] = high[:, :, 0] << np.uint16(low) | high[:, :, 1] & mask
    out[:, :, 1] = high[:, :, 2] << np.uint16(low) | (high[:, :, 1] >> np.uint16(4)) & mask
    return out.reshape(len(groups), -1)
