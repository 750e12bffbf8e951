"""What DLPC900 commands carry: settings to bytes, status bytes to records. Pure.

Here: mode, sequence and power settings, and the status, version and error registers. Not here: the frame
around them (`packets`), sequence entries (`lut`), images (`images`), trigger edges (`options`).
"""

import enum
import struct
from dataclasses import dataclass
from typing import Final

from gs2ci_drivers.dlpc900.packets import MalformedHidReplyError

CHUNK_BYTES: Final = 504
MAX_IMAGES: Final = 18


class DisplayMode(enum.IntEnum):
    """Where patterns come from (0x1A1B)."""

    ON_THE_FLY = 3


class PatternControl(enum.IntEnum):
    """Commands to the sequencer (0x1A24); a start after STOP begins with the first pattern."""

    STOP = 0
    START = 2


class PowerMode(enum.IntEnum):
    """Power of the controller (0x0200)."""

    NORMAL = 0
    STANDBY = 1


def encode_lut_config(entries: int, count: int) -> bytes:
    """Encode how many entries the sequence has and how many are shown, 0 for endless (0x1A31).

    Whether `count` is in patterns or in repeats differs between firmware revisions: see `firmware`.
    """
    return struct.pack("<HI", entries, count)


def encode_image_start(index: int, total_bytes: int) -> bytes:
    """Encode the announcement of an image: index, and bytes including the 48-byte header (0x1A2A, 0x1A2C)."""
    return struct.pack("<HI", index, total_bytes)


def encode_image_chunks(block: bytes) -> list[bytes]:
    """Cut an image block into payloads of 0x1A2B: a byte count and 1 to 504 bytes each, never an empty one."""
    chunks = (block[at : at + CHUNK_BYTES] for at in range(0, len(block), CHUNK_BYTES))
    return [len(chunk).to_bytes(2, "little") + chunk for chunk in chunks]


def encode_block_load(first: int, count: int) -> bytes:
    """Encode which mirror blocks are loaded: the first one, and their number (0x1A40, DLPU018 table 2-101)."""
    return bytes([first, count])


@dataclass(frozen=True)
class MainStatus:
    """The controller's main status (0x1A0C)."""

    parked: bool
    running: bool

    @classmethod
    def decode(cls, data: bytes) -> "MainStatus":
        """Read the register.

        Raises:
            MalformedReplyError: There is no byte.
        """
        bits = decode_byte(data, "main status")
        return cls(bool(bits & 1), bool(bits & 2))


_HARDWARE_FAULTS: Final = {
    1: "wrong mirror device for this controller",
    2: "error in the mirror reset controller",
    3: "forced buffer swap",
    6: "sequencer aborted",
    7: "sequencer error",
}


@dataclass(frozen=True)
class HardwareStatus:
    """The controller's hardware status (0x1A0A).

    Args:
        dual_controller: A secondary controller drives the right half of the mirrors.
        faults: The faults in words; empty if there are none.
    """

    dual_controller: bool
    faults: tuple[str, ...]

    @classmethod
    def decode(cls, data: bytes) -> "HardwareStatus":
        """Read the register.

        Raises:
            MalformedReplyError: There is no byte.
        """
        bits = decode_byte(data, "hardware status")
        faults = tuple(words for bit, words in _HARDWARE_FAULTS.items() if bits >> bit & 1)
        if not bits & 1:
            faults = ("internal initialisation failed", *faults)
        return cls(bool(bits >> 4 & 1), faults)


def decode_version(data: bytes) -> tuple[int, int, int]:
    """Read major, minor and patch number of the firmware (0x0205, its application's).

    Raises:
        MalformedReplyError: Fewer than 4 bytes.
    """
    if len(data) < 4:
        raise MalformedHidReplyError(f"a firmware version in {len(data)} bytes", allowed="4 bytes")
    patch, minor, major = struct.unpack_from("<HBB", data)
    return major, minor, patch


def decode_least_exposures(data: bytes) -> tuple[int, ...]:
    """Read the shortest time on show for 1 to 8 bits, µs (0x1A42).

    Raises:
        MalformedReplyError: Fewer than 16 bytes.
    """
    if len(data) < 16:
        raise MalformedHidReplyError(f"least exposures in {len(data)} bytes", allowed="16 bytes")
    return struct.unpack("<8H", data[:16])


def decode_hardware_type(data: bytes) -> tuple[int, str]:
    """Read the mirror device's type number and the firmware's tag (0x0206).

    Raises:
        MalformedReplyError: There is no byte.
    """
    return decode_byte(data, "hardware type"), decode_text(data[1:32])


def decode_text(data: bytes) -> str:
    """Read text up to its NUL; the bytes after it are left over from earlier messages."""
    return data.split(b"\0", 1)[0].decode("ascii", errors="replace").strip()


def decode_byte(data: bytes, what: str) -> int:
    """Read a one-byte register.

    Raises:
        MalformedReplyError: There is no byte.
    """
    if not data:
        raise MalformedHidReplyError(f"{what} is empty", allowed="1 byte")
    return data[0]
