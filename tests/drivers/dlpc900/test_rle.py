"""RLE coding: golden streams, round trips through the driver's and the firmware's decoder, damaged streams."""

from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci_drivers.dlpc900 import erle, rle
from gs2ci_sims.wires.dlpc900_images import BadImageError
from tests.drivers.dlpc900.firmware import reads

read = partial(reads, compression=1)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([[0xAABBCC]], "01 AA BB CC 00 00 00 00 00 01 00 00"),
        ([[1, 2, 3]], "00 03 00 00 01 00 00 02 00 00 03 00 00 00 00 00 00 01 00 00"),
        ([[4, 4, 4], [4, 4, 4]], "03 00 00 04 00 00 00 00 03 00 00 04 00 00 00 00 00 01 00 00"),
    ],
)
def test_small_images_are_these_bytes(rows: list[list[int]], expected: str) -> None:
    assert rle.encode(np.array(rows, np.uint32)) == bytes.fromhex(expected)


def test_runs_and_literals_above_255_are_cut() -> None:
    stream = rle.encode(np.full((1, 600), 7, np.uint32))
    assert stream[:12] == bytes.fromhex("FF 00 00 07 FF 00 00 07 5A 00 00 07")
    stream = rle.encode(np.arange(256, dtype=np.uint32)[None])
    assert stream[:2] == bytes.fromhex("00 FF")
    assert stream[767:771] == bytes.fromhex("01 00 00 FF")


def test_the_enhanced_coding_is_not_longer_for_masks() -> None:
    masks = np.random.default_rng(0).integers(0, 1 << 24, (54, 96), dtype=np.uint32)
    for words in (masks, np.kron(masks, np.ones((4, 4), np.uint32))):
        assert len(erle.encode(words)) <= len(rle.encode(words))


DAMAGED = [
    "03 00 00 01",
    "00 03 00 00 01",
    "02 00 00",
    "02 00 00 01 00 00 00 00",
    "01 00 00 01 00 00 00 00",
    "02 00 00 01 00 00 00 00 00 01",
    "02 00 00 01 00 00 00 00 02 00 00 01 00 00 00 00 02 00 00 01",
    "02 00 00 01 00 00 00 00 02 00 00 01 00 00 00 00 00 00",
    "02 00 00 01 00 00 00 00 02 00 00 01 00 00 00 00 00 01 00 00 00 00",
    "",
]


@pytest.mark.parametrize("stream", DAMAGED)
def test_a_damaged_stream_is_refused_by_the_firmware(stream: str) -> None:
    with pytest.raises(BadImageError):
        read(bytes.fromhex(stream), 2, 2)


@given(
    st.one_of(
        st.binary(max_size=60),
        st.lists(
            st.sampled_from([bytes(4), b"\0\1\0\0", b"\3abc", b"\1xyz", b"\0\3" + bytes(9) + b"\0", b"\2pqr"]),
            max_size=12,
        ).map(b"".join),
    )
)
def test_any_bytes_are_an_image_or_refused_by_the_firmware(stream: bytes) -> None:
    with suppress(BadImageError):
        assert read(stream, 3, 3).shape == (3, 3)
