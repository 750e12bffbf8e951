"""Pixel layouts of mono and Bayer sensors, and their unpacking to u16; pure numpy.

Here: what a four-character code means (bits, packing, mosaic), the geometry of a frame as the kernel stated it, and
`unpack`. Not here: ioctls.

Layouts (linux/Documentation/userspace-api/media/v4l/pixfmt-*): 8-bit containers; 16-bit little-endian containers,
the value in the low bits unless the rig file says otherwise; MIPI CSI-2 packing, 4 pixels in 5 bytes (10 bit), 2 in
3 (12 bit) or 4 in 7 (14 bit). Rockchip's receivers give the codes of 16-bit containers to values one after another, the
first in the lowest bits ("compact"; rk-camera-module and rkcif-config.h: CSI_LVDS_MEM_COMPACT).
"""

import enum
import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import U8, U16
from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern

Alignment = Literal["low", "high", "repeated"]
RawBytes = bytes | bytearray | memoryview | U8


class Packing(enum.Enum):
    """How pixels lie in a row: pixels per group and bytes per group."""

    BYTES = (1, 1)
    WORDS = (1, 2)
    MIPI10 = (4, 5)
    MIPI12 = (2, 3)
    MIPI14 = (4, 7)
    STREAM = (4, 0)


@dataclass(frozen=True)
class PixelFormat:
    """What a four-character code means.

    Args:
        code: V4L2 four-character code, padded with blanks.
        bits: Significant bits of a pixel.
        packing: How pixels lie in a row.
        cfa: Colour filter array, None for mono.
        bus_code: The media-bus code that carries it (linux/media-bus-format.h), for sub-devices.
    """

    code: str
    bits: int
    packing: Packing
    cfa: CfaPattern | None = None
    bus_code: int | None = None

    @property
    def group(self) -> tuple[int, int]:
        """Get how many pixels lie together, and in how many bytes."""
        pixels, size = self.packing.value
        return pixels, size or pixels * self.bits // 8

    def row_bytes(self, width: int) -> int:
        """Compute how many bytes a row of `width` pixels takes, without padding."""
        pixels, size = self.group
        return math.ceil(width / pixels) * size


def _bayer(bits: int, packing: Packing, codes: dict[CfaPattern, str], bus: dict[CfaPattern, int]) -> list[PixelFormat]:
    return [PixelFormat(code, bits, packing, cfa, bus.get(cfa)) for cfa, code in codes.items()]


_BUS8: Final[dict[CfaPattern, int]] = {"BGGR": 0x3001, "GBRG": 0x3013, "GRBG": 0x3002, "RGGB": 0x3014}
_BUS10: Final[dict[CfaPattern, int]] = {"BGGR": 0x3007, "GBRG": 0x300E, "GRBG": 0x300A, "RGGB": 0x300F}
_BUS12: Final[dict[CfaPattern, int]] = {"BGGR": 0x3008, "GBRG": 0x3010, "GRBG": 0x3011, "RGGB": 0x3012}
_BUS14: Final[dict[CfaPattern, int]] = {"BGGR": 0x3019, "GBRG": 0x301A, "GRBG": 0x301B, "RGGB": 0x301C}
_BUS16: Final[dict[CfaPattern, int]] = {"BGGR": 0x301D, "GBRG": 0x301E, "GRBG": 0x301F, "RGGB": 0x3020}

PIXEL_FORMATS: Final[dict[str, PixelFormat]] = {
    entry.code: entry
    for entry in (
        PixelFormat("GREY", 8, Packing.BYTES, bus_code=0x2001),
        PixelFormat("Y10 ", 10, Packing.WORDS, bus_code=0x200A),
        PixelFormat("Y12 ", 12, Packing.WORDS, bus_code=0x2013),
        PixelFormat("Y14 ", 14, Packing.WORDS, bus_code=0x202D),
        PixelFormat("Y16 ", 16, Packing.WORDS, bus_code=0x202E),
        PixelFormat("Y10P", 10, Packing.MIPI10, bus_code=0x200A),
        PixelFormat("Y12P", 12, Packing.MIPI12, bus_code=0x2013),
        PixelFormat("Y14P", 14, Packing.MIPI14, bus_code=0x202D),
        *_bayer(8, Packing.BYTES, {"BGGR": "BA81", "GBRG": "GBRG", "GRBG": "GRBG", "RGGB": "RGGB"}, _BUS8),
        *_bayer(10, Packing.WORDS, {"BGGR": "BG10", "GBRG": "GB10", "GRBG": "BA10", "RGGB": "RG10"}, _BUS10),
        *_bayer(12, Packing.WORDS, {"BGGR": "BG12", "GBRG": "GB12", "GRBG": "BA12", "RGGB": "RG12"}, _BUS12),
        *_bayer(14, Packing.WORDS, {"BGGR": "BG14", "GBRG": "GB14", "GRBG": "GR14", "RGGB": "RG14"}, _BUS14),
        *_bayer(16, Packing.WORDS, {"BGGR": "BYR2", "GBRG": "GB16", "GRBG": "GR16", "RGGB": "RG16"}, _BUS16),
        *_bayer(10, Packing.MIPI10, {"BGGR": "pBAA", "GBRG": "pGAA", "GRBG": "pgAA", "RGGB": "pRAA"}, _BUS10),
        *_bayer(12, Packing.MIPI12, {"BGGR": "pBCC", "GBRG": "pGCC", "GRBG": "pgCC", "RGGB": "pRCC"}, _BUS12),
        *_bayer(14, Packing.MIPI14, {"BGGR": "pBEE", "GBRG": "pGEE", "GRBG": "pgEE", "RGGB": "pREE"}, _BUS14),
    )
}


def bus_bits(pixel: PixelFormat) -> dict[int, int]:
    """Return the bits of the media-bus codes that may carry a pixel format, its own first, {} if it has none.

    A receiver may widen what a sensor sends to 16 bits: rp1-cfe makes Y16 of Y10 (cfe-fmts.h, CFE_REMAP_16BIT).
    """
    others = [one for one in PIXEL_FORMATS.values() if one.cfa == pixel.cfa] if pixel.bits == 16 else []
    return {one.bus_code: one.bits for one in (pixel, *others) if one.bus_code is not None}


@dataclass(frozen=True)
class FrameGeometry:
    """The layout of a frame as the kernel reported it after S_FMT.

    Args:
        pixel: What the pixels are.
        width: Columns.
        height: Rows.
        stride: Bytes from one row to the next, at least the packed row.
        significant_bits: Bits that carry the value; fewer than the format's if a driver puts, for example, 12-bit
            samples into `Y16`, as rp1-cfe does in the upper bits.
        alignment: Position of the value in a 16-bit container: `low` (value = word), `high` (left-aligned, zeros below)
            or `repeated` (left-aligned, its top bits repeated below: VI5 of NVIDIA's Jetson Xavier and Orin).

    Raises:
        InputError: A size below 1, a stride shorter than a row, or bits that the container does not have.
    """

    pixel: PixelFormat
    width: int
    height: int
    stride: int
    significant_bits: int
    alignment: Alignment = "low"

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"frame of {self.width}x{self.height} pixels", allowed="at least 1x1")
        if self.stride < self.pixel.row_bytes(self.width):
            raise InputError(
                f"{self.stride} bytes per line for {self.width} pixels of {self.pixel.code!r}",
                allowed=f"at least {self.pixel.row_bytes(self.width)}",
                remedy="the camera driver states an impossible geometry; try another pixel format",
            )
        if not 1 <= self.significant_bits <= self.pixel.bits:
            raise InputError(
                f"{self.significant_bits} significant bits in {self.pixel.code!r}",
                allowed=f"1 to {self.pixel.bits}",
            )
        if self.alignment != "low" and self.pixel.packing is not Packing.WORDS:
            raise InputError(
                f"left-aligned values in {self.pixel.code!r}",
                allowed="alignment 'high' and 'repeated' only in 16-bit containers (Y10, Y12, Y16, RG10, ...)",
                remedy="leave alignment out",
            )

    @property
    def full_scale(self) -> int:
        """Get the largest value a pixel can have, in DN."""
        return (1 << self.significant_bits) - 1

    @property
    def payload_bytes(self) -> int:
        """Get how many bytes must have been filled; the padding after the last row may be missing."""
        return self.stride * (self.height - 1) + self.pixel.row_bytes(self.width)


class PixelRangeError(InputError):
    """A pixel value exceeds the format's range: the frame is corrupt, or the alignment is set wrongly."""


def unpack(data: RawBytes, geometry: FrameGeometry) -> U16:
    """Unpack raw frame bytes to DN.

    Args:
        data: At least `geometry.payload_bytes` bytes, rows top-down.
        geometry: Sizes, stride and packing.

    Returns:
        Pixels, [H, W] uint16 in [0, geometry.full_scale]; a copy, `data` may be reused.

    Raises:
        InputError: Too few bytes.
        PixelRangeError: A value above full scale, or bits set below a left-aligned value.
    """
    raw = np.frombuffer(data, np.uint8)
    if raw.size < geometry.payload_bytes:
        raise InputError(
            f"{raw.size} bytes for a frame of {geometry.width}x{geometry.height} {geometry.pixel.code!r}",
            allowed=f"at least {geometry.payload_bytes}",
            remedy="drop the frame; it was cut short",
        )
    if geometry.pixel.packing is Packing.BYTES:
        values = _rows(raw, geometry, 1)[:, :, 0].astype(np.uint16)
    elif geometry.pixel.packing is Packing.WORDS:
        return _aligned(_words(raw, geometry), geometry)
    else:
        pixels, size = geometry.pixel.group
        groups = _rows(raw, geometry, size)
        streamed = geometry.pixel.packing is Packing.STREAM
        values = _stream(groups, geometry) if streamed else _mipi(groups, pixels, geometry.width)
    _check_range(values, geometry)
    return values


def _rows(raw: U8, geometry: FrameGeometry, size: int) -> U8:
    """View the bytes as [H, groups, size] without copying, the padding at row ends left out."""
    groups = geometry.pixel.row_bytes(geometry.width) // size
    return np.ndarray((geometry.height, groups, size), np.uint8, raw, strides=(geometry.stride, size, 1))


def _words(raw: U8, geometry: FrameGeometry) -> U16:
    view = np.ndarray((geometry.height, geometry.width), "<u2", raw, strides=(geometry.stride, 2))
    return view.astype(np.uint16)


def _aligned(words: U16, geometry: FrameGeometry) -> U16:
    if geometry.alignment == "low":
        _check_range(words, geometry)
        return words
    spare = 16 - geometry.significant_bits
    if spare == 0:
        return words
    values = words >> np.uint16(spare)
    # Values are padded with zeros or with their own top bits; any other bits there mean that the values are
    # right-aligned, and shifting would lose the low bits of the picture.
    if geometry.alignment == "high" and int(np.bitwise_or.reduce(words, axis=None)) & ((1 << spare) - 1):
        raise PixelRangeError(
            f"a {geometry.pixel.code!r} pixel has bits set below its {geometry.significant_bits} upper bits",
            allowed="zeros there",
            remedy=_other_alignment(words, geometry),
        )
    if geometry.alignment == "repeated" and not _repeats(words, geometry.significant_bits):
        raise PixelRangeError(
            f"a {geometry.pixel.code!r} pixel does not repeat its top bits below the {geometry.significant_bits} upper",
            allowed="its top bits there",
            remedy=_other_alignment(words, geometry),
        )
    return values


def _repeats(words: U16, bits: int) -> bool:
    """Return whether the bits below the upper `bits` ones of every word repeat its top bits."""
    spare = 16 - bits
    return bool(np.array_equal(words & np.uint16((1 << spare) - 1), words >> np.uint16(bits)))


def _other_alignment(words: U16, geometry: FrameGeometry) -> str:
    """Return what to do about words that are aligned otherwise than stated, from the words themselves."""
    bits = geometry.significant_bits
    low = int(words.max()) <= geometry.full_scale
    repeated = bits < 16 and not low and _repeats(words, bits)
    high = not int(np.bitwise_or.reduce(words, axis=None)) & ((1 << (16 - bits)) - 1)
    found = "low" if low else "repeated" if repeated else "high" if high else ""
    if not found or found == geometry.alignment:
        return f"no alignment of {bits} bits fits: set significant_bits in [sensor] from the camera's data sheet"
    why = ": their top bits are repeated below them, as on Jetson" if repeated else ""
    return f"if every frame says so, set alignment = {found!r} in [sensor] for this camera{why}"


def _stream(groups: U8, geometry: FrameGeometry) -> U16:
    """Unpack [H, G, S] bytes: four values one after another, the first in the lowest bits."""
    bits = geometry.pixel.bits
    words = sum(groups[:, :, k].astype(np.uint64) << np.uint64(8 * k) for k in range(groups.shape[2]))
    values = np.stack([words >> np.uint64(bits * i) & np.uint64(2**bits - 1) for i in range(4)], axis=2)
    return np.ascontiguousarray(values.reshape(len(groups), -1)[:, : geometry.width], dtype=np.uint16)


def _mipi(groups: U8, pixels: int, width: int) -> U16:
    """Unpack [H, G, S] bytes: P high bytes, then the low bits of P pixels, pixel 0 lowest (10, 12 or 14 bits each)."""
    size = groups.shape[2]
    bits = 8 * (size - pixels) // pixels
    tail: NDArray[Any] = groups[:, :, pixels]
    for k in range(pixels + 1, size):
        tail = tail | groups[:, :, k].astype(np.uint32) << np.uint32(8 * (k - pixels))
    out = np.empty((*groups.shape[:2], pixels), np.uint16)
    for i in range(pixels):
        out[:, :, i] = groups[:, :, i]
        out[:, :, i] <<= bits
        out[:, :, i] |= ((tail >> tail.dtype.type(bits * i)) & tail.dtype.type(2**bits - 1)).astype(np.uint16)
    return np.ascontiguousarray(out.reshape(groups.shape[0], -1)[:, :width])


def _check_range(values: U16, geometry: FrameGeometry) -> None:
    largest = int(values.max())
    if largest > geometry.full_scale:
        raise PixelRangeError(
            f"a {geometry.pixel.code!r} pixel reads {largest}",
            allowed=f"0 to {geometry.full_scale} ({geometry.significant_bits} bits)",
            remedy=_other_alignment(values, geometry),
        )
