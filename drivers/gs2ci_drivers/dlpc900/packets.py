"""DLPC900 messages as bytes: requests, 64-byte reports, replies, command and error codes. Pure.

Here: the frame around every command. Not here: what the commands carry (`payloads`, `lut`, `images`), and the
exchange (`channel`). Imported by the driver, tests and, for its USB ids, `gs2ci.rig`; the wire twin frames messages
with code of its own.

Request ``[flags, sequence, length LE, command LE, data]``, where the length counts command and data; reply
``[flags, sequence, length LE, data]``, where it counts the data alone and no command is repeated. Only the first
64-byte report of a message has the header, later ones are plain continuation. DLPU018, section 1.2.
"""

import enum
from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import DeviceError

VENDOR_ID: Final = 0x0451
PRODUCT_ID: Final = 0xC900
REPORT_BYTES: Final = 64
# One buffer of 512 bytes serves both directions; header (4) and command (2) take their bytes from it.
BUFFER_BYTES: Final = 512
MAX_REPLY_BYTES: Final = BUFFER_BYTES - 4

_READ: Final = 0x80
_REPLY_WANTED: Final = 0x40
_REFUSED: Final = 0x20


class MalformedHidReplyError(DeviceError):
    """Bytes from the device that are no reply; the driver adds the device and the request."""


class Command(enum.IntEnum):
    """USB command numbers (DLPU018, chapter 2)."""

    ERROR_CODE = 0x0100
    ERROR_TEXT = 0x0101
    POWER_MODE = 0x0200
    IDLE_MODE = 0x0201
    VERSIONS = 0x0205
    HARDWARE_TYPE = 0x0206
    FLIP_LONG = 0x1008
    FLIP_SHORT = 0x1009
    LED_ENABLES = 0x1A07
    HARDWARE_STATUS = 0x1A0A
    MAIN_STATUS = 0x1A0C
    DISPLAY_MODE = 0x1A1B
    TRIGGER_OUT_1 = 0x1A1D
    TRIGGER_OUT_2 = 0x1A1E
    PATTERN_CONTROL = 0x1A24
    IMAGE_START = 0x1A2A
    IMAGE_DATA = 0x1A2B
    IMAGE_START_SECONDARY = 0x1A2C
    IMAGE_DATA_SECONDARY = 0x1A2D
    INVERT_DATA = 0x1A30
    LUT_CONFIG = 0x1A31
    LUT_ENTRY = 0x1A34
    BLOCK_LOAD = 0x1A40
    LEAST_EXPOSURES = 0x1A42


# TI's own host library never requests an answer to these, so that the controller can take the next report at once.
NEVER_ACKNOWLEDGED: Final = frozenset({Command.IMAGE_DATA, Command.IMAGE_DATA_SECONDARY})


@dataclass(frozen=True)
class ErrorCode:
    """What a code in the error register (0x0100) means and what to do about it."""

    meaning: str
    remedy: str


_REINSTALL = "power-cycle the controller; if it persists, reflash its firmware"
_AGAIN = "upload the sequence again"
ERROR_CODES: Final[dict[int, ErrorCode]] = {
    0: ErrorCode("no error", ""),
    1: ErrorCode("batch file checksum", _REINSTALL),
    2: ErrorCode("device failure", "check the cables between controller and mirror board, then power-cycle"),
    3: ErrorCode("invalid command", "the firmware does not know this command: choose another firmware profile"),
    4: ErrorCode("controller and mirror device do not match", "flash the firmware made for this mirror device"),
    5: ErrorCode("command not allowed in this mode", "stop the sequence and select pattern-on-the-fly mode first"),
    6: ErrorCode("bad parameter", _AGAIN),
    7: ErrorCode("item absent", "the firmware lacks the requested item"),
    8: ErrorCode("out of memory", "use fewer images or larger superpixels"),
    9: ErrorCode("bad compression of a pattern image", _AGAIN),
    10: ErrorCode("bit depth out of range", "use 1 to 8 bits per mask"),
    11: ErrorCode("pattern image not in flash", "select pattern-on-the-fly mode"),
    12: ErrorCode("dark time out of range", "change dark_s"),
    13: ErrorCode("signal delay out of range", "keep trigger delays within -20 to 20000 µs, pulses at least 20 µs"),
    14: ErrorCode("exposure time out of range", "raise exposure_s to the minimum for this bit depth"),
    15: ErrorCode("pattern number out of range", "use fewer masks"),
    16: ErrorCode("invalid pattern definition", _AGAIN),
    17: ErrorCode("image memory address out of range", "use fewer images"),
    255: ErrorCode("internal error", _REINSTALL),
}


def describe_error(code: int) -> ErrorCode:
    """Return meaning and remedy of an error code, also for an unknown one."""
    return ERROR_CODES.get(code, ErrorCode(f"unknown error code {code}", _REINSTALL))


def read_request(command: Command, sequence: int) -> bytes:
    """Build a message that reads `command`; the device answers with its data."""
    return _request(_READ | _REPLY_WANTED, command, sequence, b"")


def write_request(command: Command, data: bytes, sequence: int, *, acknowledge: bool = True) -> bytes:
    """Build a message that writes `data` to `command`, with or without an acknowledgement."""
    return _request(_REPLY_WANTED if acknowledge else 0, command, sequence, data)


def _request(flags: int, command: Command, sequence: int, data: bytes) -> bytes:
    length = (2 + len(data)).to_bytes(2, "little")
    return bytes([flags, sequence]) + length + int(command).to_bytes(2, "little") + data


def split_reports(message: bytes) -> list[bytes]:
    """Cut a message into 64-byte reports, the last one padded with zeros."""
    padded = message.ljust(-(-len(message) // REPORT_BYTES) * REPORT_BYTES, b"\0")
    return [padded[at : at + REPORT_BYTES] for at in range(0, len(padded), REPORT_BYTES)]


@dataclass(frozen=True)
class HidReply:
    """One answer of the device.

    Args:
        sequence: The number of the request that it answers.
        data: The payload, without padding.
        is_read: Whether it answers a read.
        refused: Whether the device refused: the refusal bit, or a read without data.
    """

    sequence: int
    data: bytes
    is_read: bool
    refused: bool


def reply_reports(first_report: bytes) -> int:
    """Return how many reports the reply that begins with `first_report` has.

    Raises:
        MalformedReplyError: Too short for a header, or more is announced than the device's buffer holds.
    """
    if len(first_report) < 4:
        raise MalformedHidReplyError(f"a reply of {len(first_report)} bytes has no header", allowed="at least 4 bytes")
    length = int.from_bytes(first_report[2:4], "little")
    if length > MAX_REPLY_BYTES:
        raise MalformedHidReplyError(
            f"a reply announces {length} bytes of data", allowed=f"at most {MAX_REPLY_BYTES} bytes"
        )
    return -(-(4 + length) // REPORT_BYTES)


def parse_reply(reports: bytes) -> HidReply:
    """Parse the joined reports of one reply.

    Raises:
        MalformedReplyError: The bytes are fewer than the header announces.
    """
    reply_reports(reports)
    flags, sequence = reports[0], reports[1]
    length = int.from_bytes(reports[2:4], "little")
    if len(reports) < 4 + length:
        raise MalformedHidReplyError(
            f"a reply announces {length} bytes of data and carries {len(reports) - 4}",
            remedy="repeat the command",
        )
    is_read = bool(flags & _READ)
    return HidReply(
        sequence=sequence,
        data=reports[4 : 4 + length],
        is_read=is_read,
        refused=bool(flags & _REFUSED) or (is_read and length == 0),
    )
