"""The DLPC900's commands, error texts and mirror devices, entered from the programmer's guide (DLPU018).

Here: tables. Not here: the effect of commands (`dlpc900_firmware`). Only the twin's files import this one; the driver
has its own tables, so that a mistake in either is detected.
"""

from dataclasses import dataclass
from typing import Final

COMMAND_NAMES: Final[dict[int, str]] = {
    0x0100: "error code",
    0x0101: "error text",
    0x0200: "power mode",
    0x0201: "idle mode",
    0x0205: "versions",
    0x0206: "hardware type",
    0x1100: "curtain colour",
    0x1A07: "LED enables",
    0x1A0A: "hardware status",
    0x1A0B: "system status",
    0x1008: "flip long axis",
    0x1009: "flip short axis",
    0x1A0C: "main status",
    0x1A1B: "display mode",
    0x1A1D: "trigger out 1",
    0x1A1E: "trigger out 2",
    0x1A24: "pattern control",
    0x1A2A: "image start",
    0x1A2B: "image data",
    0x1A2C: "image start secondary",
    0x1A2D: "image data secondary",
    0x1A30: "invert data",
    0x1A31: "table config",
    0x1A34: "table entry",
    0x1A35: "trigger in 1",
    0x1A36: "trigger in 2",
    0x1A40: "block load",
    0x1A42: "least exposures",
    0x1A43: "least LED pulse",
}
ERROR_TEXT: Final = {
    0: "No Error",
    3: "Invalid Command",
    5: "Command Not Allowed In This Mode",
    6: "Invalid Parameter",
    9: "BMP Compression Error",
    10: "Bit Number Out Of Range",
    13: "Signal Delay Out Of Range",
    14: "Exposure Time Out Of Range",
    15: "Pattern Number Out Of Range",
    16: "Invalid Pattern Definition",
    17: "Image Address Out Of Range",
}


@dataclass(frozen=True)
class Mirrors:
    """Size, shortest times in µs by depth, table length, and whether two controllers share the columns.

    `block_us` has the shortest 1-bit times by number of active blocks (DLPU018, table 2-102).
    """

    width: int
    height: int
    shortest_us: tuple[int, ...]
    entries: int = 400
    block_us: tuple[int, ...] = ()
    dual: bool = False

    @property
    def blocks(self) -> int:
        """Get the number of mirror blocks, 0 if the guide states none."""
        return len(self.block_us)


MIRRORS: Final = {
    1: Mirrors(
        1920, 1080, (105, 304, 394, 823, 1215, 1487, 1998, 4046),
        block_us=(24, 45, 45, 45, 48, 54, 60, 66, 72, 78, 84, 90, 96, 101, 105),
    ),
    2: Mirrors(
        2560, 1600, (105, 304, 380, 733, 1215, 1487, 1998, 4046), dual=True,
        block_us=(24, 42, 42, 42, 45, 51, 56, 61, 67, 72, 77, 83, 88, 93, 99, 105),
    ),
    3: Mirrors(
        2716, 1600, (100, 343, 438, 768, 1299, 1488, 2000, 4046), dual=True,
        block_us=(27, 27, 27, 33, 38, 38, 49, 55, 61, 66, 72, 77, 83, 89, 94, 100),
    ),
    4: Mirrors(
        2048, 1200, (62, 184, 269, 458, 682, 807, 1083, 2263), dual=True,
        block_us=(30, 30, 30, 30, 34, 38, 42, 46, 50, 54, 58, 62),
    ),
    5: Mirrors(1024, 768, (1, 1, 1, 1, 1, 1, 1, 1), entries=960),
}  # fmt: skip
