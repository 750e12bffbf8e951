"""Lines and blocks of the open modulator protocol, version 1 (docs/scpi-modulator.md). Pure.

Here: tagged and checked lines, definite-length pattern blocks, replies, mask packing. Not here: the exchange
(`link`). Imported by the driver and tests; the wire twin parses with code of its own.

A tagged line is answered by exactly one tagged line::

    @17 SEQ:ARM*2F        ->  @17 OK*63
    @18 SYST:ERR?*XX      ->  @18 0,"No error"*XX

The two hex digits are the exclusive or of all characters between "@" and "*".
"""

import re
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci.core.errors import DeviceError

PROTOCOL: Final = "GS2CI-MOD"
VERSION: Final = 1
TAGS: Final = 1000

_REPLY: Final = re.compile(rb"@(\d{1,3}) ([\x20-\x29\x2b-\x7e]*)\*([0-9A-F]{2})\Z")
_ERROR: Final = re.compile(r'([+-]?\d{1,5}),"([^"]*)"\Z')


class MalformedScpiReplyError(DeviceError):
    """A line that is no reply; the driver adds the device and the request."""


@dataclass(frozen=True)
class ScpiReply:
    """A reply: the tag of its request, and its text."""

    tag: int
    body: str


def checksum(text: bytes) -> int:
    """Return the exclusive or of all bytes."""
    total = 0
    for byte in text:
        total ^= byte
    return total


def request(tag: int, command: str) -> bytes:
    """Build a tagged line of a command, one line of plain ASCII without "*" at its end."""
    text = f"{tag} {command}".encode("ascii")
    return b"@%b*%02X\n" % (text, checksum(text))


def block_request(tag: int, index: int, data: bytes) -> bytes:
    """Build the line that loads one mask; its CRC-32 covers index and data, so the line has no checksum."""
    length = str(len(data))
    head = f"@{tag} SEQ:DATA {index},{block_crc(index, data):08X},#{len(length)}{length}"
    return head.encode("ascii") + data + b"\n"


def block_crc(index: int, data: bytes) -> int:
    """Return the CRC-32 (IEEE 802.3) of the mask's index in decimal, a colon, and its bytes."""
    return zlib.crc32(data, zlib.crc32(f"{index}:".encode("ascii")))


def parse_reply(line: bytes) -> ScpiReply:
    """Parse a line without its end.

    Raises:
        MalformedReplyError: Not a tagged line, or its checksum is wrong.
    """
    match = _REPLY.match(line)
    if not match:
        raise MalformedScpiReplyError("not a tagged reply", allowed="@TAG TEXT*XX")
    expected = checksum(line[1:-3])
    if int(match[3], 16) != expected:
        raise MalformedScpiReplyError(f"checksum {match[3].decode()}", allowed=f"{expected:02X}")
    return ScpiReply(int(match[1]), match[2].decode("ascii"))


def parse_error(body: str) -> tuple[int, str]:
    """Parse an entry of the error queue: (code, text), code 0 when it is empty.

    Raises:
        MalformedReplyError: Not a number and a quoted text.
    """
    match = _ERROR.match(body)
    if not match:
        raise MalformedScpiReplyError(f"error entry {body!r}", allowed='CODE,"TEXT"')
    return int(match[1]), match[2]


def parse_integers(body: str, count: int | None = None) -> tuple[int, ...]:
    """Parse whole numbers separated by commas.

    Raises:
        MalformedReplyError: Something else, or not `count` of them.
    """
    fields = body.split(",")
    if not all(re.fullmatch(r"[+-]?\d{1,12}", field) for field in fields) or count not in (None, len(fields)):
        raise MalformedScpiReplyError(f"numbers {body!r}", allowed=f"{count or 'some'} whole numbers, comma-separated")
    return tuple(int(field) for field in fields)


def pack_mask(levels: U8 | U16, bits: int) -> bytes:
    """Pack one mask [H, W] for the wire, rows from the top.

    1 bit: eight pixels a byte, leftmost in the highest bit, each row padded to whole bytes. 2 to 8 bits: one byte
    a pixel. 9 to 16 bits: two bytes a pixel, low byte first.
    """
    if bits == 1:
        return np.packbits(levels.astype(np.bool_), axis=1).tobytes()
    return levels.astype(np.uint8 if bits <= 8 else "<u2").tobytes()


def mask_bytes(height: int, width: int, bits: int) -> int:
    """Return how many bytes `pack_mask` returns for a mask."""
    if bits == 1:
        return height * -(-width // 8)
    return height * width * (1 if bits <= 8 else 2)
