"""ERLE coding: golden streams, round trips through the driver's and the firmware's decoder, damaged streams."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.arrays import U32
from gs2ci_drivers.dlpc900 import erle
from gs2ci_sims.wires.dlpc900_images import BadImageError
from tests.drivers.dlpc900.firmware import reads as read


def test_all_on_in_pattern_0_is_the_reference_stream_of_6484_bytes() -> None:
    stream = erle.encode(np.ones((1080, 1920), np.uint32))
    assert len(stream) == 6484
    assert stream[:7] == bytes.fromhex("80 0F 00 00 01 00 00")
    assert stream[7:-3] == bytes.fromhex("00 01 80 0F 00 00") * 1079
    assert stream[-3:] == bytes.fromhex("00 01 00")


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([[0xAABBCC]], "01 AA BB CC 00 00 00 01 00 00 00 00"),
        ([[1, 2, 3]], "00 03 00 00 01 00 00 02 00 00 03 00 00 00 01 00"),
        ([[1, 2, 2, 2]], "01 00 00 01 03 00 00 02 00 00 00 01 00 00 00 00"),
        # Two of a kind are a run where one begins anyway, and stay among literals otherwise.
        ([[2, 2, 3]], "02 00 00 02 01 00 00 03 00 00 00 01 00 00 00 00"),
        ([[1, 2, 2, 3]], "00 04 00 00 01 00 00 02 00 00 02 00 00 03 00 00 00 01 00 00"),
        # A copy of one pixel is as long as the pixel.
        ([[7], [7]], "01 00 00 07 00 00 01 00 00 07 00 00 00 01 00 00"),
        ([[5, 6], [5, 6]], "00 02 00 00 05 00 00 06 00 00 00 01 02 00 00 00 01 00 00 00"),
    ],
)
def test_small_images_are_these_bytes(rows: list[list[int]], expected: str) -> None:
    assert erle.encode(np.array(rows, np.uint32)) == bytes.fromhex(expected)


def test_counts_from_128_on_take_two_bytes_low_bits_first() -> None:
    stream = erle.encode(np.full((1, 0x1234), 7, np.uint32))
    assert stream[:5] == bytes.fromhex("B4 24 00 00 07")


def test_no_image_takes_more_than_the_stated_worst_case(image: U32) -> None:
    height, width = image.shape
    assert len(erle.encode(image)) <= 4 * height * width + 2 * height + 6


def test_a_slice_of_a_larger_image_is_encoded_as_itself() -> None:
    whole = np.random.default_rng(2).integers(0, 1 << 24, (30, 80), dtype=np.uint32)
    np.testing.assert_array_equal(read(erle.encode(whole[:, 40:]), 40, 30), whole[:, 40:])


# Two rows of two pixels: literals 1 2, end of row, copy of two, end of row, end of image.
GOOD = "00 02 00 00 01 00 00 02 00 00 00 01 02 00 00 00 01 00"
DAMAGED = [
    "03 00 00 01",
    "00 03 00 00 01 00 00 02 00 00 03",
    "00 01 02",
    "00 02 00 00 01 00 00 02 00 00 00 01 02 00 00",
    "00 02 00 00 01 00 00",
    "00 02 00 00 01 00 00 02 00 00 00 01 00",
    "01 00 00 01 00 00",
    "00 00",
    "80 00 00 00 01",
    "00 80 00 00 00 01",
    "80",
    "00",
    "",
    GOOD + " 00 00 00 00",
    GOOD[:-9] + " 02 00 00 01 00 00 00 01 00",
    GOOD[:-9] + " 00 00 00 01 00",
]


@pytest.mark.parametrize("stream", DAMAGED)
def test_a_damaged_stream_is_refused_by_the_firmware(stream: str) -> None:
    with pytest.raises(BadImageError):
        read(bytes.fromhex(stream), 2, 2)


@pytest.mark.parametrize("padding", ["", " 00", " FF FF FF"])
def test_up_to_three_bytes_of_padding_and_missing_row_marks_are_fine(padding: str) -> None:
    expected = np.array([[1, 2], [1, 2]], np.uint32)
    without_marks = "00 02 00 00 01 00 00 02 00 01 02 00 01 00"
    for stream in (GOOD + padding, without_marks + padding):
        np.testing.assert_array_equal(read(bytes.fromhex(stream), 2, 2), expected)


streams = st.one_of(
    st.binary(max_size=60),
    st.lists(
        st.sampled_from(
            [b"\0\0", b"\0\1\0", b"\0\1\2", b"\0\1\3", b"\0\2" + bytes(6), b"\3abc", b"\1xyz", b"\x80\1pqr"]
        ),
        max_size=14,
    ).map(b"".join),
)


@given(streams)
def test_any_bytes_are_an_image_or_refused_by_the_firmware(stream: bytes) -> None:
    with suppress(BadImageError):
        assert read(stream, 3, 3).shape == (3, 3)


@given(st.data())
def test_one_flipped_bit_never_hangs_or_crashes_the_firmware(data: st.DataObject) -> None:
    stream = bytearray(erle.encode(np.arange(60, dtype=np.uint32).reshape(5, 12) // 3))
    at = data.draw(st.integers(0, len(stream) - 1))
    stream[at] ^= 1 << data.draw(st.integers(0, 7))
    with suppress(BadImageError):
        assert read(bytes(stream), 12, 5).shape == (5, 12)
