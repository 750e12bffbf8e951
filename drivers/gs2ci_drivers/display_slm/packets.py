"""Frames of the SLM-200 class protocol: commands, status, image rows. Pure.

Here: bytes. Not here: the conversation (`driver`). Imported by the driver and tests.

A frame has 16 bytes — "SEND", u16 length code (high byte first), one zero byte, u8 kind, one zero byte, the row's
number in three bytes (low byte first), four zero bytes — and its payload (SlmCtrl.m, Santec Corporation, 2022:
slm_Ctrl_WriteXX, RequestReceiveData, slm_Ctrl_WriteMI). Lengths of whole frames are inferred from it.
"""

import enum
import struct
from typing import Final

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci.core.errors import DeviceError

HEIGHT: Final = 1200
WIDTH: Final = 1920
TOP_LEVEL: Final = 1023
SLOTS: Final = 128
HEADER_BYTES: Final = 16
TEXT_BYTES: Final = 1024
ROW_BYTES: Final = 4096
_HEADER: Final = struct.Struct(">4sHxBx3s4x")
_SIGNATURE: Final = b"SEND"
_TEXT_CODE: Final = 0x00FF
_ROW_CODE: Final = 0x03BF


class MalformedSlmReplyError(DeviceError):
    """Bytes from the panel that are no status; the driver adds the device and the request."""


class SlmFrameKind(enum.IntEnum):
    """What a frame is."""

    CONTROL = 1
    STATUS_REQUEST = 2
    STATUS = 3
    IMAGE_ROW = 4


def control(text: str) -> bytes:
    """Build a command frame: two letters, numbers, line feed."""
    payload = text.encode("ascii") + b"\n"
    return _header(_TEXT_CODE, SlmFrameKind.CONTROL) + payload.ljust(TEXT_BYTES, b"\0")


def status_request() -> bytes:
    """Build the frame that requests the status of the last command."""
    return _header(0, SlmFrameKind.STATUS_REQUEST)


def _header(code: int, kind: SlmFrameKind, row: int = 0) -> bytes:
    return _HEADER.pack(_SIGNATURE, code, kind, row.to_bytes(3, "little"))


def image(levels: U16) -> bytes:
    """Build the frames of one image: a row each, and the sum of all pixels in the last four bytes.

    Args:
        levels: [1200, 1920] uint16, 0 to 1023.
    """
    frames = np.zeros((HEIGHT, HEADER_BYTES + ROW_BYTES), np.uint8)
    headers = b"".join(_header(_ROW_CODE, SlmFrameKind.IMAGE_ROW, row) for row in range(HEIGHT))
    frames[:, :HEADER_BYTES] = np.frombuffer(headers, np.uint8).reshape(HEIGHT, HEADER_BYTES)
    pixels = np.ascontiguousarray(levels, "<u2").view(np.uint8)
    frames[:, HEADER_BYTES : HEADER_BYTES + 2 * WIDTH] = pixels.reshape(HEIGHT, 2 * WIDTH)
    total = int(levels.sum(dtype=np.uint64)) & 0xFFFFFFFF
    frames[-1, -4:] = np.frombuffer(struct.pack("<I", total), np.uint8)
    return frames.tobytes()


def find_status(buffer: bytes) -> tuple[str | None, bytes]:
    """Look for a status frame in the bytes received so far.

    Returns:
        Its text, or None if it is not complete yet; and the bytes that remain to be searched.

    Raises:
        MalformedReplyError: A complete frame of another kind came.
    """
    begin = buffer.find(_SIGNATURE)
    if begin < 0:
        # The signature's own first letters may stand at the end.
        return None, buffer[-(len(_SIGNATURE) - 1) :]
    buffer = buffer[begin:]
    if len(buffer) < HEADER_BYTES:
        return None, buffer
    _, code, kind, _ = _HEADER.unpack(buffer[:HEADER_BYTES])
    if (code, kind) != (_TEXT_CODE, SlmFrameKind.STATUS):
        raise MalformedSlmReplyError(
            f"frame of kind {kind} with length code {code:#06x}",
            allowed=f"{SlmFrameKind.STATUS} with {_TEXT_CODE:#06x}",
        )
    if len(buffer) < HEADER_BYTES + TEXT_BYTES:
        return None, buffer
    text = buffer[HEADER_BYTES : HEADER_BYTES + TEXT_BYTES].split(b"\0", 1)[0]
    if not text.isascii():
        raise MalformedSlmReplyError(f"status text {text[:16]!r}", allowed="ASCII")
    return text.decode("ascii").strip(), buffer[HEADER_BYTES + TEXT_BYTES :]
