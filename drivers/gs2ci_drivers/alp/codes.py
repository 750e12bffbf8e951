"""Numbers of the ALP interface, and the meaning of its return codes in our words.

Source: alp4lib 1.1 (MIT), ALP4.py, which takes them from the maker's header alp.h; states and codes that it leaves out:
olfa-lab/DmdLib, dmdlib/_alp_defns.py (from alp.h, version 12).
"""

import struct
from enum import IntEnum
from typing import Final


class Alp(IntEnum):
    """Codes, types and values that are used here."""

    OK = 0
    NOT_ONLINE = 1001
    NOT_IDLE = 1002
    NOT_AVAILABLE = 1003
    NOT_READY = 1004
    PARM_INVALID = 1005
    ERROR_COMM = 1011
    DEVICE_REMOVED = 1012
    DEV_BUSY = 1100
    DEVICE_NUMBER = 2000
    VERSION = 2001
    DEV_STATE = 2002
    AVAIL_MEMORY = 2003
    DEV_DMDTYPE = 2021
    DEV_DYN_SYNCH_OUT1_GATE = 2023
    DDC_FPGA_TEMPERATURE = 2050
    APPS_FPGA_TEMPERATURE = 2051
    PCB_TEMPERATURE = 2052
    DEV_DISPLAY_HEIGHT = 2057
    DEV_DISPLAY_WIDTH = 2058
    DEV_DMD_MODE = 2064
    SEQ_REPEAT = 2100
    BIN_MODE = 2104
    BIN_NORMAL = 2105
    BIN_UNINTERRUPTED = 2106
    DATA_FORMAT = 2110
    MIN_PICTURE_TIME = 2211
    MIN_ILLUMINATE_TIME = 2212
    MAX_PICTURE_TIME = 2213
    PROJ_INVERSION = 2306


POWER_FLOAT: Final = 1
"""Value of DEV_DMD_MODE: the mirrors are released, and show nothing."""
NO_MIRRORS: Final = 255
"""Value of DEV_DMDTYPE: no mirror device is connected, and the board behaves as with one of 1920 x 1080."""
SIZES: Final = {3: (1080, 1920), **dict.fromkeys((4, 5, 6), (768, 1024)), 7: (1200, 1920)}
"""Value of DEV_DMDTYPE -> rows and columns, for libraries that do not tell them ("old API versions did not support
ALP_DEV_DISPLAY_WIDTH and _HEIGHT": ViALUX's samples)."""
MSB_ALIGN: Final = 0
"""Value of DATA_FORMAT: one byte per mirror, of which the highest bit counts for binary pictures."""
GONE: Final = (Alp.NOT_ONLINE, Alp.ERROR_COMM, Alp.DEVICE_REMOVED)
MOST_GATED: Final = 16
"""Pictures after which the pattern of a gated synch output repeats, at most (tAlpDynSynchOutGate)."""
MEANINGS: Final[dict[int, str]] = {
    1001: "no such device, or not ready",
    1002: "the device is not idle",
    1003: "no such device or sequence",
    1004: "another program has the device",
    1005: "a parameter that this device or library does not take",
    1006: "the data cannot be read",
    1007: "the device's memory is full",
    1008: "the sequence is being shown",
    1009: "stopped while data were sent",
    1010: "the device cannot be initialised",
    1011: "communication failed",
    1012: "the device has been unplugged",
    1013: "its FPGA is not configured",
    1014: "the USB driver is too old",
    1018: "the mirrors do not wake up",
    1019: "the drivers are too old",
    1020: "its memory cannot be initialised",
}


def gate(pulses: list[bool], *, active_high: bool) -> bytes:
    """Return the setting of a gated synch output (tAlpDynSynchOutGate, 18 bytes without padding).

    Args:
        pulses: Which pictures have a pulse, 1 to `MOST_GATED`; repeated after that.
        active_high: Whether a pulse is high.
    """
    return struct.pack("<BB16s", len(pulses), int(active_high), bytes(pulses))
