"""Frames of the SLM-200 class protocol byte by byte, and what becomes of any bytes that come back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci_drivers.display_slm.packets import MalformedSlmReplyError, control, find_status, image, status_request

STATUS = bytes.fromhex("53454e44 00ff 00 03 00000000 00000000") + b"OK".ljust(1024, b"\0")


def test_a_command_is_a_header_and_1024_bytes_of_text() -> None:
    frame = control("DS 12")
    assert frame[:16] == bytes.fromhex("53454e44 00ff 00 01 00000000 00000000")
    assert frame[16:] == b"DS 12\n".ljust(1024, b"\0")


def test_a_status_request_is_a_bare_header() -> None:
    assert status_request() == bytes.fromhex("53454e44 0000 00 02 00000000 00000000")


def test_an_image_is_a_frame_per_row_and_the_sum_in_the_last_four_bytes() -> None:
    levels = np.zeros((1200, 1920), np.uint16)
    levels[0, :2] = 0x0102, 0x0203
    levels[1199, 1919] = 1023
    frames = image(levels)
    assert len(frames) == 1200 * 4112
    assert frames[:20] == bytes.fromhex("53454e44 03bf 00 04 00000000 00000000 0201 0302")
    last = frames[-4112:]
    assert last[:16] == bytes.fromhex("53454e44 03bf 00 04 00 af0400 00000000")
    # SlmCtrl.m, slm_Ctrl_WriteMI: the row's number stands in acBuf[9], [10] and [11], its low byte first
    assert frames[300 * 4112 + 8 : 300 * 4112 + 12] == bytes([0, 300 % 256, 300 // 256, 0])
    assert last[16 + 3838 : 16 + 3840] == bytes.fromhex("ff03")
    assert last[-4:] == (0x0102 + 0x0203 + 1023).to_bytes(4, "little")


def test_a_status_is_found_behind_noise_and_leaves_the_rest() -> None:
    assert find_status(b"\0\xffSE" + STATUS + b"SEN") == ("OK", b"SEN")


def test_an_incomplete_status_is_waited_for() -> None:
    buffer = b""
    for at in range(len(STATUS)):
        text, buffer = find_status(buffer + STATUS[at : at + 1])
        assert (text == "OK") == (at == len(STATUS) - 1)


@pytest.mark.parametrize(
    "frame",
    [STATUS.replace(b"\x03", b"\x09", 1), STATUS.replace(b"\xff", b"\xfe", 1), STATUS.replace(b"OK", b"O\xff")],
)
def test_a_frame_of_another_kind_is_malformed(frame: bytes) -> None:
    with pytest.raises(MalformedSlmReplyError):
        find_status(frame)


@given(st.binary(max_size=60), st.booleans())
def test_any_bytes_are_a_status_or_waited_for_or_a_typed_error(data: bytes, signed: bool) -> None:
    try:
        text, rest = find_status((b"SEND" if signed else b"") + data)
    except MalformedSlmReplyError:
        return
    assert text is None
    assert len(rest) <= len(data) + 4
