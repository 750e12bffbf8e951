"""Image blocks: the 48 bytes in front, bit-planes, halves, and blocks that are broken."""

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.arrays import U8
from gs2ci.core.errors import InputError
from gs2ci_drivers.dlpc900.images import (
    encode_block,
    pack_planes,
    place_of,
    split_halves,
)
from gs2ci_sims.wires.dlpc900_images import BadImageError, read_image


def test_the_reference_header_is_these_48_bytes() -> None:
    header = encode_block(np.ones((1080, 1920), np.uint32))[:48]
    assert header == bytes.fromhex("53706c64 8007 3804 54190000 ffffffffffffffff 00000000 01 02 01" + "00" * 21)


@pytest.mark.parametrize("width", [1, 5, 16, 33])
def test_a_block_comes_back_through_the_firmware(width: int) -> None:
    words = np.random.default_rng(3).integers(0, 1 << 24, (7, width), dtype=np.uint32)
    block = encode_block(words, pixel_format=0)
    np.testing.assert_array_equal(read_image(block, width, 7), words)


@pytest.mark.parametrize("depth_bits", range(1, 9))
def test_every_mask_sits_where_place_of_says(depth_bits: int) -> None:
    levels = np.random.default_rng(4).integers(0, 1 << depth_bits, (30, 6, 5), dtype=np.uint8)
    images = pack_planes(levels, depth_bits)
    assert len(images) == -(-30 // (24 // depth_bits))
    for i, level in enumerate(levels):
        image, bit = place_of(i, depth_bits)
        np.testing.assert_array_equal(images[image] >> bit & ((1 << depth_bits) - 1), level)


def test_one_bit_mask_k_is_bit_k_of_the_word() -> None:
    levels = np.zeros((24, 1, 24), np.uint8)
    levels[np.arange(24), 0, np.arange(24)] = 1
    assert pack_planes(levels)[0].tolist() == [[1 << k for k in range(24)]]


@pytest.mark.parametrize(
    ("levels", "depth_bits"),
    [
        (np.full((1, 2, 2), 2, np.uint8), 1),
        (np.zeros((1, 2, 2), np.uint8), 9),
        (np.zeros((1, 2, 2), np.uint8), 0),
        (np.zeros((2, 2), np.uint8), 1),
        (np.zeros((0, 2, 2), np.uint8), 1),
        (np.zeros((1, 2, 2), np.uint16), 1),
    ],
)
def test_masks_that_do_not_fit_are_refused(levels: U8, depth_bits: int) -> None:
    with pytest.raises(InputError, match="allowed"):
        pack_planes(levels, depth_bits)


def test_halves_are_left_and_right() -> None:
    words = np.arange(12, dtype=np.uint32).reshape(2, 6)
    left, right = split_halves(words)
    np.testing.assert_array_equal(np.hstack([left, right]), words)
    assert left.shape == right.shape == (2, 3)


def _with(block: bytes, at: int, *values: int) -> bytes:
    return block[:at] + bytes(values) + block[at + len(values) :]


BLOCK = encode_block(np.arange(6, dtype=np.uint32).reshape(2, 3))
BROKEN = {
    "cut": BLOCK[:40],
    "signature": _with(BLOCK, 0, 0),
    "compression": _with(BLOCK, 25, 3),
    "byte order": _with(BLOCK, 26, 0),
    "no width": _with(BLOCK, 4, 0, 0),
    "size too large": _with(BLOCK, 8, 255),
    "size too small": _with(BLOCK, 8, 4),
    "size of the mirrors": _with(BLOCK, 4, 4, 0),
    "stream": _with(BLOCK, 48, 255, 255),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_block_is_refused_by_the_firmware(name: str) -> None:
    with pytest.raises(BadImageError):
        read_image(BROKEN[name], 3, 2)


@given(st.binary(max_size=120), st.booleans())
def test_any_bytes_are_an_image_or_refused_by_the_firmware(data: bytes, keeps_header: bool) -> None:
    block = BLOCK[:48] + data if keeps_header else data
    with suppress(BadImageError):
        read_image(block, 3, 2)
