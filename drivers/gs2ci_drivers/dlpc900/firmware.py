"""Where DLPC900 firmware revisions differ, as named profiles that the rig file chooses. Pure.

The programmer's guide contradicts itself between revisions about the second number of 0x1A31: revision F calls it
repeats, revision J the number of patterns to show (entries × repeats). Counting a board's trigger pulses shows which
one it follows (`pulses`).
"""

import enum
from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError


class CountUnit(enum.Enum):
    """The unit of the count of 0x1A31."""

    PATTERNS = "patterns"
    REPEATS = "repeats"


@dataclass(frozen=True)
class FirmwareProfile:
    """What a firmware revision expects.

    Args:
        name: As written in the rig file.
        count_unit: The unit of the count of 0x1A31.
        pixel_format: Byte 24 of the image header: 1 in TI's code, 0 in its guide.
        stops_after_mode: Whether a second stop is sent after the mode change, as is common practice.
    """

    name: str
    count_unit: CountUnit
    pixel_format: int = 1
    stops_after_mode: bool = True

    def count(self, entries: int, repeats: int) -> int:
        """Return the count of 0x1A31 for `repeats` rounds of `entries`; 0 repeats mean for ever."""
        return entries * repeats if self.count_unit is CountUnit.PATTERNS else repeats


PROFILES: Final[dict[str, FirmwareProfile]] = {
    "rev-j": FirmwareProfile("rev-j", CountUnit.PATTERNS),
    "rev-f": FirmwareProfile("rev-f", CountUnit.REPEATS, pixel_format=0),
}
DEFAULT_PROFILE: Final = "rev-j"


def profile(name: str) -> FirmwareProfile:
    """Return a profile by name.

    Raises:
        InputError: There is none of that name.
    """
    if name not in PROFILES:
        raise InputError(f"firmware profile '{name}'", allowed=", ".join(sorted(PROFILES)))
    return PROFILES[name]
