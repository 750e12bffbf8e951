"""Lines of the open modulator protocol byte by byte, and what becomes of any bytes that come back."""

import zlib
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci_drivers.scpi_modulator.packets import (
    MalformedScpiReplyError,
    ScpiReply,
    block_crc,
    block_request,
    mask_bytes,
    pack_mask,
    parse_error,
    parse_integers,
    parse_reply,
    request,
)


def test_a_request_carries_tag_text_and_check() -> None:
    assert request(1, "SYST:VERS?") == b"@1 SYST:VERS?*0B\n"
    assert request(14, "SEQ:ARM") == b"@14 SEQ:ARM*06\n"


def test_a_block_carries_index_crc_and_length() -> None:
    data = b"\n*#\x00\xff"
    crc = zlib.crc32(b"7:" + data)
    assert block_crc(7, data) == crc
    assert block_request(12, 7, data) == f"@12 SEQ:DATA 7,{crc:08X},#15".encode() + data + b"\n"


def test_a_reply_is_tag_and_text() -> None:
    assert parse_reply(b'@12 -221,"Settings conflict"*00') == ScpiReply(12, '-221,"Settings conflict"')
    assert parse_reply(b"@4 250*23") == ScpiReply(4, "250")


@pytest.mark.parametrize(
    "line",
    [b"", b"OK", b"@4 250", b"@4 250*24", b"@4 251*23", b"@4 250*2", b"@4 250*23 ", b"@ 250*23", b"@4 2*0*23"],
)
def test_a_line_that_is_no_checked_reply_is_malformed(line: bytes) -> None:
    with pytest.raises(MalformedScpiReplyError, match="allowed"):
        parse_reply(line)


@pytest.mark.parametrize(
    ("parse", "body"),
    [
        (parse_error, "0"),
        (parse_error, '0,"No error'),
        (parse_error, 'x,"No error"'),
        (parse_integers, ""),
        (parse_integers, "1,"),
        (parse_integers, "1.5"),
        (parse_integers, "9" * 13),
        (lambda body: parse_integers(body, 2), "1,2,3"),
    ],
)
def test_a_value_of_the_wrong_form_is_malformed(parse: Callable[[str], object], body: str) -> None:
    with pytest.raises(MalformedScpiReplyError, match="allowed"):
        parse(body)


@given(st.binary(max_size=80))
def test_any_bytes_are_a_reply_or_a_typed_error(line: bytes) -> None:
    try:
        reply = parse_reply(line)
    except MalformedScpiReplyError:
        return
    assert request(reply.tag, reply.body).strip() == line or line.startswith(b"@0")


@given(st.text(max_size=40))
def test_any_text_is_a_value_or_a_typed_error(body: str) -> None:
    for parse in (parse_error, parse_integers):
        try:
            parse(body)
        except MalformedScpiReplyError:
            continue


@pytest.mark.parametrize(("bits", "expected"), [(1, "A0 80 50 00"), (8, "01 00 01 00 00 00 00 00 01"), (10, None)])
def test_masks_are_packed_rows_first_and_the_leftmost_pixel_in_the_highest_bit(bits: int, expected: str | None) -> None:
    levels = np.array([[1, 0, 1, 0, 0, 0, 0, 0, 1], [0, 1, 0, 1, 0, 0, 0, 0, 0]], np.uint16)
    packed = pack_mask(levels, bits)
    assert len(packed) == mask_bytes(2, 9, bits)
    if expected:
        assert packed.startswith(bytes.fromhex(expected))
    else:
        assert packed == levels.astype("<u2").tobytes()


def test_numbers_with_a_plus_are_read_as_ieee_488_allows_them() -> None:
    """Agilent's and others' instruments answer so: "+0,"No error"" (NR1 of IEEE 488.2)."""
    assert parse_error('+0,"No error"') == (0, "No error")
    assert parse_integers("+300,-2,400") == (300, -2, 400)
