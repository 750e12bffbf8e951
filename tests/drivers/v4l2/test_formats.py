"""Unpacking of pixels against a reference that walks bit by bit, and every refusal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci.core.errors import InputError
from gs2ci_drivers.v4l2.formats import (
    PIXEL_FORMATS,
    Alignment,
    FrameGeometry,
    Packing,
    PixelRangeError,
    unpack,
)


def pack_slowly(pixels: np.ndarray, geometry: FrameGeometry, padding: int) -> bytes:
    """Pack pixels one bit at a time, by the tables of the V4L2 manual; row padding is filled with `padding`."""
    out = bytearray()
    for row in pixels:
        line = bytearray(geometry.pixel.row_bytes(geometry.width))
        shift = 16 - geometry.significant_bits if geometry.alignment == "high" else 0
        for x, value in enumerate(int(v) << shift for v in row):
            for bit in range(16):
                if not value >> bit & 1:
                    continue
                place, to_bit = _bit_place(geometry.pixel.packing, x, bit)
                line[place] |= 1 << to_bit
        out += line + bytes([padding]) * (geometry.stride - len(line))
    return bytes(out)


def _bit_place(packing: Packing, x: int, bit: int) -> tuple[int, int]:
    """Tell which byte of the row, and which bit in it, carries bit `bit` of pixel `x`."""
    match packing:
        case Packing.BYTES:
            return x, bit
        case Packing.WORDS:
            return 2 * x + bit // 8, bit % 8
        case Packing.MIPI10:
            group, i = divmod(x, 4)
            return (5 * group + i, bit - 2) if bit >= 2 else (5 * group + 4, 2 * i + bit)
        case Packing.MIPI12:
            group, i = divmod(x, 2)
            return (3 * group + i, bit - 4) if bit >= 4 else (3 * group + 2, 4 * i + bit)
        case Packing.MIPI14:
            group, i = divmod(x, 4)
            place, to_bit = divmod(6 * i + bit, 8)
            return (7 * group + i, bit - 6) if bit >= 6 else (7 * group + 4 + place, to_bit)


@st.composite
def frames(draw: st.DrawFn) -> tuple[np.ndarray, FrameGeometry, int]:
    pixel = PIXEL_FORMATS[draw(st.sampled_from(sorted(PIXEL_FORMATS)))]
    width, height = draw(st.integers(1, 19)), draw(st.integers(1, 5))
    stride = pixel.row_bytes(width) + draw(st.integers(0, 9))
    bits = draw(st.integers(1, pixel.bits))
    high = pixel.packing is Packing.WORDS and draw(st.booleans())
    alignment: Alignment = "high" if high else "low"
    geometry = FrameGeometry(pixel, width, height, stride, bits, alignment)
    seed = draw(st.integers(0, 2**32 - 1))
    pixels = np.random.default_rng(seed).integers(0, 1 << bits, (height, width))
    return pixels.astype(np.uint16), geometry, draw(st.integers(0, 255))


@settings(max_examples=300, deadline=None)
@given(frames())
def test_every_format_unpacks_as_the_bitwise_reference_packs(
    case: tuple[np.ndarray, FrameGeometry, int],
) -> None:
    pixels, geometry, padding = case
    got = unpack(pack_slowly(pixels, geometry, padding), geometry)
    assert got.dtype == np.uint16
    assert got.flags.c_contiguous
    np.testing.assert_array_equal(got, pixels)


@settings(max_examples=100, deadline=None)
@given(frames())
def test_the_padding_after_the_last_row_may_be_missing(case: tuple[np.ndarray, FrameGeometry, int]) -> None:
    pixels, geometry, padding = case
    data = pack_slowly(pixels, geometry, padding)[: geometry.payload_bytes]
    np.testing.assert_array_equal(unpack(data, geometry), pixels)
    with pytest.raises(InputError, match="bytes for a frame"):
        unpack(data[:-1], geometry)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(sorted(PIXEL_FORMATS)), st.integers(1, 9), st.integers(1, 4), st.binary(max_size=120))
def test_any_bytes_give_a_picture_or_a_typed_error(code: str, width: int, height: int, data: bytes) -> None:
    pixel = PIXEL_FORMATS[code]
    geometry = FrameGeometry(pixel, width, height, pixel.row_bytes(width), pixel.bits)
    try:
        got = unpack(data, geometry)
    except InputError:
        return
    assert got.shape == (height, width)
    assert got.max() <= geometry.full_scale


def test_unpacking_copies_so_that_the_buffer_can_be_queued_again() -> None:
    data = bytearray(range(12))
    geometry = FrameGeometry(PIXEL_FORMATS["GREY"], 4, 3, 4, 8)
    got = unpack(data, geometry)
    data[:] = bytes(12)
    assert got[2, 3] == 11


def test_golden_bytes_of_the_packed_layouts() -> None:
    ten = FrameGeometry(PIXEL_FORMATS["pRAA"], 4, 1, 5, 10)
    assert unpack(bytes([0xFF, 0x00, 0x80, 0x01, 0b11_10_01_00]), ten).tolist() == [[0x3FC, 0x001, 0x202, 0x007]]
    twelve = FrameGeometry(PIXEL_FORMATS["Y12P"], 2, 1, 3, 12)
    assert unpack(bytes([0xAB, 0x12, 0x3C]), twelve).tolist() == [[0xABC, 0x123]]
    # linux, pixfmt-srggb14p.rst: G01 low bits 1--0 and B00 low bits 5--0, R02 low bits 3--0 and G01 low bits 5--2, ...
    fourteen = FrameGeometry(PIXEL_FORMATS["pBEE"], 4, 1, 7, 14)
    data = bytes([0xFF, 0x00, 0x80, 0x01, 0b01_100001, 0b0110_1101, 0b101010_11])
    assert unpack(data, fourteen).tolist() == [[0x3FE1, 0b110101, 0x2000 | 0b110110, 0x40 | 0b101010]]


def test_left_aligned_values_are_shifted_only_when_told_so() -> None:
    data = (0xABC0).to_bytes(2, "little")
    high = FrameGeometry(PIXEL_FORMATS["Y16 "], 1, 1, 2, 12, "high")
    assert unpack(data, high).tolist() == [[0xABC]]
    low = FrameGeometry(PIXEL_FORMATS["Y16 "], 1, 1, 2, 12)
    with pytest.raises(PixelRangeError, match="alignment = 'high'"):
        unpack(data, low)


def test_right_aligned_values_declared_left_aligned_are_refused_instead_of_cut() -> None:
    geometry = FrameGeometry(PIXEL_FORMATS["Y12 "], 1, 1, 2, 12, "high")
    with pytest.raises(PixelRangeError, match="alignment = 'low'"):
        unpack((0x0ABC).to_bytes(2, "little"), geometry)


def test_rubbish_above_ten_bits_is_refused() -> None:
    geometry = FrameGeometry(PIXEL_FORMATS["RG10"], 1, 1, 2, 10)
    with pytest.raises(PixelRangeError, match="reads 1024"):
        unpack((1024).to_bytes(2, "little"), geometry)


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        (("GREY", 0, 4, 8, 8, "low"), "0x4 pixels"),
        (("GREY", 4, 0, 8, 8, "low"), "4x0 pixels"),
        (("Y10P", 5, 4, 9, 10, "low"), "at least 10"),
        (("Y10 ", 4, 4, 8, 11, "low"), "1 to 10"),
        (("GREY", 4, 4, 4, 0, "low"), "1 to 8"),
        (("Y12P", 4, 4, 6, 12, "high"), "16-bit containers"),
    ],
)
def test_impossible_geometry_is_refused(geometry: tuple[str, int, int, int, int, Alignment], message: str) -> None:
    code, width, height, stride, bits, alignment = geometry
    with pytest.raises(InputError, match=message):
        FrameGeometry(PIXEL_FORMATS[code], width, height, stride, bits, alignment)


def test_bayer_codes_name_their_mosaic_and_bus() -> None:
    assert {f.cfa for f in PIXEL_FORMATS.values()} == {None, "RGGB", "BGGR", "GRBG", "GBRG"}
    assert PIXEL_FORMATS["BA12"].cfa == "GRBG"
    assert PIXEL_FORMATS["RG10"].bus_code == 0x300F
    assert PIXEL_FORMATS["Y12P"].bus_code == 0x2013
    # raspberrypi/linux, rp1-cfe/cfe-fmts.h: SGRBG14P of SGRBG14_1X14; linux/media-bus-format.h: 0x301b
    assert (PIXEL_FORMATS["pgEE"].cfa, PIXEL_FORMATS["pgEE"].bus_code) == ("GRBG", 0x301B)
    assert (PIXEL_FORMATS["GR14"].cfa, PIXEL_FORMATS["GR14"].bus_code) == ("GRBG", 0x301B)
