"""Where DLPC900 firmware revisions differ, as named profiles that the rig file chooses. Pure.

The programmer's guide contradicts itself between revisions about the second number of 0x1A31: revision F calls it
repeats, revision J the number of patterns to show (entries × repeats). Counting a board's trigger pulses shows which
one it follows (`pulses`).
"""

import enum
from dataclasses import dataclass
from typing import Final


class CountUnit(enum.Enum):
    """The unit of the count of 0x1A31."""

    PATTERNS = "patterns"
    REPEATS = "repeats"


@dataclass(frozen=True)
class FirmwareProfile:
    """What a firmware revision expects.

    Args:
        count_unit: The unit of the count of 0x1A31.
        pixel_format: Byte 24 of the image header: 1 in TI's code, 0 in its guide.
    """

    count_unit: CountUnit
    pixel_format: int = 1

    def count(self, entries: int, repeats: int) -> int:
        """Return the count of 0x1A31 for `repeats` rounds of `entries`; 0 repeats mean for ever."""
        return entries * repeats if self.count_unit is CountUnit.PATTERNS else repeats


PROFILES: Final[dict[str, FirmwareProfile]] = {
    "rev-j": FirmwareProfile(CountUnit.PATTERNS),
    "rev-f": FirmwareProfile(CountUnit.REPEATS, pixel_format=0),
}
DEFAULT_PROFILE: Final = "rev-j"
