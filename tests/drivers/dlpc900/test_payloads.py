"""Settings to bytes and registers to records, with every limit of the reference."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gs2ci_drivers.dlpc900.options import TriggerEdges
from gs2ci_drivers.dlpc900.packets import MalformedHidReplyError
from gs2ci_drivers.dlpc900.payloads import (
    HardwareStatus,
    MainStatus,
    decode_byte,
    decode_hardware_type,
    decode_text,
    decode_version,
    encode_block_load,
    encode_image_chunks,
    encode_image_start,
    encode_lut_config,
)


@pytest.mark.parametrize(
    ("payload", "expected"),
    [
        (TriggerEdges(fall_us=20).encode(), "00 00 00 14 00"),
        (TriggerEdges(rise_us=-20, fall_us=20000).encode(), "00 EC FF 20 4E"),
        (TriggerEdges(inverted=True, rise_us=5, fall_us=-5).encode(), "01 05 00 FB FF"),
        (encode_lut_config(400, 0), "90 01 00 00 00 00"),
        (encode_image_start(17, 6532), "11 00 84 19 00 00"),
        (encode_block_load(0, 15), "00 0F"),
    ],
)
def test_a_setting_is_these_bytes(payload: bytes, expected: str) -> None:
    assert payload == bytes.fromhex(expected)


@pytest.mark.parametrize("edges", [{"rise_us": -21}, {"fall_us": 20001}, {"rise_us": 30, "fall_us": 20}])
def test_edges_out_of_range_are_refused(edges: dict[str, int]) -> None:
    with pytest.raises(ValidationError, match=r"rise_us|fall_us"):
        TriggerEdges(**edges)  # type: ignore[arg-type]


@given(st.binary(min_size=1, max_size=3000))
def test_chunks_carry_the_block_and_none_is_empty(block: bytes) -> None:
    chunks = encode_image_chunks(block)
    assert all(1 <= int.from_bytes(chunk[:2], "little") == len(chunk) - 2 <= 504 for chunk in chunks)
    assert b"".join(chunk[2:] for chunk in chunks) == block


def test_a_block_of_whole_chunks_ends_without_an_empty_one() -> None:
    assert len(encode_image_chunks(bytes(1008))) == 2


def test_main_status_names_its_bits() -> None:
    assert MainStatus.decode(b"\x01") == MainStatus(True, False)
    assert MainStatus.decode(b"\x0e") == MainStatus(False, True)


def test_hardware_status_names_its_faults() -> None:
    assert HardwareStatus.decode(b"\x11") == HardwareStatus(True, ())
    assert HardwareStatus.decode(b"\x41").faults == ("sequencer aborted",)
    assert len(HardwareStatus.decode(b"\xce").faults) == 6


def test_versions_are_patch_minor_major() -> None:
    data = bytes.fromhex("01000206 00000002 05000300 00010004")
    assert decode_version(data) == (6, 2, 1)


def test_text_ends_at_its_nul_and_what_follows_is_stale() -> None:
    assert decode_text(b"Invalid Command\0stale rubbish") == "Invalid Command"
    assert decode_text(b"\xff\xfe\0") == "��"
    assert decode_hardware_type(b"\x02tag\0rest") == (2, "tag")


@pytest.mark.parametrize(
    "decode",
    [
        MainStatus.decode,
        HardwareStatus.decode,
        decode_version,
        decode_hardware_type,
        lambda d: decode_byte(d, "it"),
    ],
)
def test_an_empty_register_is_malformed(decode: Callable[[bytes], object]) -> None:
    with pytest.raises(MalformedHidReplyError):
        decode(b"")


@given(st.binary(max_size=64))
def test_any_bytes_are_a_register_or_a_typed_error(data: bytes) -> None:
    for decode in (MainStatus.decode, HardwareStatus.decode, decode_version, decode_hardware_type):
        try:
            decode(data)
        except MalformedHidReplyError:
            assert len(data) < 4
