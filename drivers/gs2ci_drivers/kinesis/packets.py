"""Messages of Thorlabs' APT protocol: a header of six bytes, and data for some.

Source: "Thorlabs Motion Controllers Host-Controller Communications Protocol", issues 23 to 39 (named MGMSG_... there);
numbers and layouts checked against thorlabs-apt-protocol (MIT), UniNE-CHYN/thorpy and thormotion (BSD). A header is
message id (2 bytes, little endian), then either two parameters or the length of the data, then destination (with bit 7
set if data follow) and source.

Here: building requests, finding whole messages in a stream, the status bits. Pure. Not here: waiting (`link`).
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final

HOST: Final = 0x01
CUBE: Final = 0x50
"""Address of a unit with a USB port of its own."""
MOTHERBOARD: Final = 0x11
FIRST_BAY: Final = 0x21
HEADER_BYTES: Final = 6
LONGEST_DATA: Final = 255
CHANNEL: Final = 1
"""Cubes have one channel, and so does each bay of a benchtop controller."""


class Message(IntEnum):
    """Ids of the messages that are used or understood here."""

    HW_REQ_INFO = 0x0005
    HW_GET_INFO = 0x0006
    HW_START_UPDATEMSGS = 0x0011
    HW_STOP_UPDATEMSGS = 0x0012
    HW_RESPONSE = 0x0080
    HW_RICHRESPONSE = 0x0081
    MOD_SET_CHANENABLESTATE = 0x0210
    MOT_REQ_POSCOUNTER = 0x0411
    MOT_GET_POSCOUNTER = 0x0412
    MOT_SET_VELPARAMS = 0x0413
    MOT_REQ_VELPARAMS = 0x0414
    MOT_GET_VELPARAMS = 0x0415
    MOT_REQ_STATUSBITS = 0x0429
    MOT_GET_STATUSBITS = 0x042A
    MOT_SET_GENMOVEPARAMS = 0x043A
    MOT_REQ_GENMOVEPARAMS = 0x043B
    MOT_GET_GENMOVEPARAMS = 0x043C
    MOT_SET_HOMEPARAMS = 0x0440
    MOT_REQ_HOMEPARAMS = 0x0441
    MOT_GET_HOMEPARAMS = 0x0442
    MOT_MOVE_HOME = 0x0443
    MOT_MOVE_HOMED = 0x0444
    MOT_MOVE_ABSOLUTE = 0x0453
    MOT_MOVE_COMPLETED = 0x0464
    MOT_MOVE_STOP = 0x0465
    MOT_MOVE_STOPPED = 0x0466
    MOT_GET_STATUSUPDATE = 0x0481
    MOT_GET_DCSTATUSUPDATE = 0x0491
    MOT_REQ_PMDSTAGEAXISPARAMS = 0x04F1
    MOT_GET_PMDSTAGEAXISPARAMS = 0x04F2


class AptStatus(IntFlag):
    """Bits of the status word (MGMSG_MOT_GET_STATUSBITS); pylablib dfd3273 and thorlabs-apt-protocol b7ed9de agree."""

    FORWARD_LIMIT = 0x1
    REVERSE_LIMIT = 0x2
    FORWARD_SOFT_LIMIT = 0x4
    REVERSE_SOFT_LIMIT = 0x8
    MOVING_FORWARD = 0x10
    MOVING_REVERSE = 0x20
    JOGGING_FORWARD = 0x40
    JOGGING_REVERSE = 0x80
    CONNECTED = 0x100
    HOMING = 0x200
    HOMED = 0x400
    MOTION_ERROR = 0x4000
    INSTRUMENT_ERROR = 0x8000
    INTERLOCK = 0x10000
    TOO_HOT = 0x20000
    SUPPLY_VOLTAGE = 0x40000
    COMMUTATION_ERROR = 0x80000
    CURRENT_LIMIT = 0x01000000
    ENCODER_FAULT = 0x02000000
    OVERCURRENT = 0x04000000
    SUPPLY_CURRENT = 0x08000000
    ENABLED = 0x80000000


MOVING: Final = (
    AptStatus.MOVING_FORWARD
    | AptStatus.MOVING_REVERSE
    | AptStatus.JOGGING_FORWARD
    | AptStatus.JOGGING_REVERSE
    | AptStatus.HOMING
)
FAULTS: Final = {
    AptStatus.MOTION_ERROR: "motion error: the position error is beyond its limit (0x4000)",
    AptStatus.TOO_HOT: "the motor's driver is too hot (0x20000)",
    AptStatus.SUPPLY_VOLTAGE: "the supply's voltage is too low (0x40000)",
    AptStatus.COMMUTATION_ERROR: "commutation error: switch the controller off and on, then home (0x80000)",
    AptStatus.CURRENT_LIMIT: "the motor's current is at its limit (0x01000000)",
    AptStatus.ENCODER_FAULT: "encoder fault: check the stage's cable (0x02000000)",
    AptStatus.OVERCURRENT: "the motor's current was too high (0x04000000)",
    AptStatus.SUPPLY_CURRENT: "too much current is drawn from the supply (0x08000000)",
}
ENDED_BY: Final = {
    **FAULTS,
    **dict.fromkeys(
        (AptStatus.FORWARD_SOFT_LIMIT, AptStatus.REVERSE_SOFT_LIMIT),
        "at a software limit, which another program has set (MGMSG_MOT_SET_LIMSWITCHPARAMS)",
    ),
    AptStatus.INSTRUMENT_ERROR: "instrument error: it could not carry a command out (0x8000)",
    AptStatus.INTERLOCK: "the signal that enables the motor, or a position error by older firmware (0x10000)",
}
"""What may have ended a move short of its target, faults or not: of 0x10000 sources disagree (P_MOT_SB_INTERLOCK, "used
in controllers where a separate signal is used to enable the motor", against the POSITION_ERR of older headers)."""
PROFILED_STOP: Final = 2
"""MGMSG_MOT_MOVE_STOP, second parameter: 1 stops at once and may lose steps, 2 decelerates."""


@dataclass(frozen=True)
class AptMessage:
    """A message that a device has sent.

    Args:
        ident: Its id.
        source: The sender's address.
        params: The two parameters of a message without data.
        data: The data, b"" for a message without.
    """

    ident: int
    source: int
    params: tuple[int, int]
    data: bytes


def short(ident: Message, dest: int, first: int = CHANNEL, second: int = 0) -> bytes:
    """Return a message without data."""
    return struct.pack("<HBBBB", ident, first, second, dest, HOST)


def long(ident: Message, dest: int, data: bytes) -> bytes:
    """Return a message with data."""
    return struct.pack("<HHBB", ident, len(data), dest | 0x80, HOST) + data


def move_absolute(dest: int, counts: int) -> bytes:
    """Return the request to move to a position."""
    return long(Message.MOT_MOVE_ABSOLUTE, dest, struct.pack("<Hi", CHANNEL, counts))


def set_speed(dest: int, acceleration: int, speed: int) -> bytes:
    """Return the setting of the speed and acceleration of moves; their first speed is always 0."""
    return long(Message.MOT_SET_VELPARAMS, dest, struct.pack("<Hiii", CHANNEL, 0, acceleration, speed))


def set_overshoot(dest: int, counts: int) -> bytes:
    """Return the setting of how far moves in reverse pass their target before they come back to it ("backlash")."""
    return long(Message.MOT_SET_GENMOVEPARAMS, dest, struct.pack("<Hi", CHANNEL, counts))


def set_homing(dest: int, direction: int, switch: int, speed: int, offset: int) -> bytes:
    """Return the setting of how a channel homes."""
    data = struct.pack("<HHHii", CHANNEL, direction, switch, speed, offset)
    return long(Message.MOT_SET_HOMEPARAMS, dest, data)


def find_message(buffer: bytes, sources: frozenset[int]) -> tuple[AptMessage | None, bytes, int]:
    """Find the first whole message of these senders in what has arrived.

    Bytes that begin no message are passed over: a header has no mark, so it is recognised by a known id, the host as
    its destination and a known sender.

    Returns:
        The message, or None if none is whole yet; what is left behind it; how many bytes were passed over.
    """
    passed = 0
    while len(buffer) - passed >= HEADER_BYTES:
        ident, low, high, dest, source = struct.unpack_from("<HBBBB", buffer, passed)
        length = low + (high << 8) if dest & 0x80 else 0
        if ident not in _KNOWN or dest & 0x7F != HOST or source not in sources or length > LONGEST_DATA:
            passed += 1
            continue
        end = passed + HEADER_BYTES + length
        if len(buffer) < end:
            break
        params = (0, 0) if dest & 0x80 else (low, high)
        return AptMessage(ident, source, params, buffer[passed + HEADER_BYTES : end]), buffer[end:], passed
    return None, buffer[passed:], passed


_KNOWN: Final = frozenset(int(ident) for ident in Message)


@dataclass(frozen=True)
class HardwareInfo:
    """What a unit says it is (MGMSG_HW_GET_INFO).

    Args:
        serial: Serial number.
        model: "KDC101", "BBD202", ...
        firmware: "major.interim.minor".
        channels: Number of its channels, of a motherboard its bays.
    """

    serial: int
    model: str
    firmware: str
    channels: int


def parse_info(data: bytes) -> HardwareInfo | None:
    """Read the data of MGMSG_HW_GET_INFO; None if they are too few."""
    if len(data) < 84:
        return None
    serial, model, _, minor, interim, major, _ = struct.unpack_from("<i8sHBBBB", data)
    (channels,) = struct.unpack_from("<H", data, 82)
    name = model.split(b"\0")[0].decode("ascii", "replace").strip()
    return HardwareInfo(serial, name, f"{major}.{interim}.{minor}", channels)


_STAGE_AXIS: Final = struct.Struct("<HHH16sIIii")
STAGE_AXIS_BYTES: Final = _STAGE_AXIS.size
"""What is read here of the 74 bytes of MGMSG_MOT_GET_PMDSTAGEAXISPARAMS."""


@dataclass(frozen=True)
class StageMemory:
    """What the memory in a stage's plug tells a brushless controller (MGMSG_MOT_GET_PMDSTAGEAXISPARAMS).

    Args:
        part: Part number.
        counts_per_unit: Encoder counts per mm, of a rotary stage per degree.
        travel: Travel in units.
    """

    part: str
    counts_per_unit: int
    travel: float


def parse_stage_memory(data: bytes) -> StageMemory | None:
    """Read a stage's memory; None if it is empty."""
    _, _, _, part, _, counts_per_unit, lowest, highest = _STAGE_AXIS.unpack_from(data)
    if counts_per_unit == 0 or highest <= lowest:
        return None
    name = part.split(b"\0")[0].decode("ascii", "replace").strip()
    return StageMemory(name, counts_per_unit, (highest - lowest) / counts_per_unit)
