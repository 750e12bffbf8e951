"""Messages of the DLPC900 byte by byte, and what becomes of any bytes that come back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci_drivers.dlpc900.lut import LutEntry
from gs2ci_drivers.dlpc900.packets import (
    ERROR_CODES,
    Command,
    HidReply,
    MalformedHidReplyError,
    describe_error,
    parse_reply,
    read_request,
    reply_reports,
    split_reports,
    write_request,
)
from gs2ci_drivers.dlpc900.payloads import DisplayMode, PatternControl, encode_image_chunks, encode_lut_config

GOLDEN = {
    "C0 04 02 00 0C 1A": read_request(Command.MAIN_STATUS, 4),
    "40 02 03 00 1B 1A 03": write_request(Command.DISPLAY_MODE, bytes([DisplayMode.ON_THE_FLY]), 2),
    "40 03 03 00 24 1A 02": write_request(Command.PATTERN_CONTROL, bytes([PatternControl.START]), 3),
    "40 09 03 00 24 1A 00": write_request(Command.PATTERN_CONTROL, bytes([PatternControl.STOP]), 9),
    "40 05 08 00 31 1A 08 00 08 00 00 00": write_request(Command.LUT_CONFIG, encode_lut_config(8, 8), 5),
    "40 01 0E 00 34 1A 05 00 69 00 00 71 00 00 00 00 00 28": write_request(
        Command.LUT_ENTRY, LutEntry(5, 105, bit_position=5).encode(), 1
    ),
    "C0 11 02 00 05 02": read_request(Command.VERSIONS, 0x11),
}


@pytest.mark.parametrize("expected", GOLDEN)
def test_a_message_is_the_reference_vector_padded_to_one_report(expected: str) -> None:
    message = GOLDEN[expected]
    assert message == bytes.fromhex(expected)
    assert split_reports(message) == [message + bytes(64 - len(message))]


def test_image_data_goes_out_as_eight_reports_of_which_only_the_first_has_a_header() -> None:
    data = bytes(range(252)) * 2
    (payload,) = encode_image_chunks(data)
    message = write_request(Command.IMAGE_DATA, payload, 7, acknowledge=False)
    reports = split_reports(message)
    assert len(reports) == 8
    assert reports[0][:8] == bytes.fromhex("00 07 FC 01 2B 1A F8 01")
    assert b"".join(reports)[8:] == data


def test_the_manuals_read_example_is_understood() -> None:
    report = bytes.fromhex("C0 11 06 00 FF 01 FF 01 FF 01").ljust(64, b"\0")
    assert parse_reply(report) == HidReply(0x11, bytes.fromhex("FF 01 FF 01 FF 01"), is_read=True, refused=False)


@pytest.mark.parametrize(
    ("head", "refused"),
    [("C0 01 00 00", True), ("E0 01 01 00 00", True), ("60 01 00 00", True), ("40 01 00 00", False)],
)
def test_the_refusal_bit_or_a_read_without_data_is_a_refusal(head: str, refused: bool) -> None:
    assert parse_reply(bytes.fromhex(head).ljust(64, b"\0")).refused is refused


def test_a_reply_may_span_reports() -> None:
    text = bytes(range(1, 129))
    reply = bytes.fromhex("C0 05 80 00") + text
    assert reply_reports(reply[:64]) == 3
    assert parse_reply(reply.ljust(192, b"\0")).data == text


@pytest.mark.parametrize(
    ("reply", "why"),
    [
        (b"", "no header"),
        (b"\xc0\x01\x01", "no header"),
        (b"\xc0\x01\xfd\x01", "509"),
        (b"\xc0\x01\x02\0\1", "carries 1"),
    ],
)
def test_a_reply_that_is_cut_or_impossible_is_malformed(reply: bytes, why: str) -> None:
    with pytest.raises(MalformedHidReplyError, match=why):
        parse_reply(reply)


@given(st.binary(max_size=600))
def test_any_bytes_are_a_reply_or_a_typed_error(reply: bytes) -> None:
    try:
        parsed = parse_reply(reply)
    except MalformedHidReplyError:
        return
    assert len(parsed.data) <= 508
    assert reply[4:].startswith(parsed.data)


@given(st.integers(0, 255), st.binary(max_size=506), st.booleans())
def test_a_request_says_how_long_it_is(sequence: int, data: bytes, acknowledge: bool) -> None:
    message = write_request(Command.POWER_MODE, data, sequence, acknowledge=acknowledge)
    assert message[0] == (0x40 if acknowledge else 0)
    assert int.from_bytes(message[2:4], "little") == len(data) + 2 == len(message) - 4
    assert all(len(report) == 64 for report in split_reports(message))


def test_every_error_code_has_a_meaning_and_a_remedy() -> None:
    assert set(ERROR_CODES) == {*range(18), 255}
    assert all(code.meaning and (code.remedy or number == 0) for number, code in ERROR_CODES.items())
    assert "unknown error code 77" in describe_error(77).meaning
