"""Where DLPC900 firmware revisions differ, as named profiles that the rig file chooses. Pure.

The programmer's guide contradicts itself between revisions about the second number of 0x1A31: revision F calls it
repeats, revision J the number of patterns to show (entries × repeats). Which one a board obeys is found by
counting its trigger pulses: `explain_pulses`. Imported by the driver, `gs2ci.rig` and tests.
"""

import enum
from dataclasses import dataclass
from typing import Final

from gs2ci.core.errors import InputError


@enum.unique
class CountUnit(enum.Enum):
    """What the count of 0x1A31 counts."""

    PATTERNS = "patterns"
    REPEATS = "repeats"


@dataclass(frozen=True)
class FirmwareProfile:
    """What a firmware revision expects.

    Args:
        name: As written in the rig file.
        count_unit: What the count of 0x1A31 counts.
        pixel_format: Byte 24 of the image header: 1 in TI's code, 0 in its guide.
        block_load: Whether partial mirror loading (0x1A40) is known.
        stops_after_mode: Whether a second stop is sent after the mode change, as field practice has it.
    """

    name: str
    count_unit: CountUnit
    pixel_format: int = 1
    block_load: bool = True
    stops_after_mode: bool = True

    def count(self, entries: int, repeats: int) -> int:
        """Return the count of 0x1A31 for `repeats` rounds of `entries`; 0 repeats mean for ever."""
        return entries * repeats if self.count_unit is CountUnit.PATTERNS else repeats

    def explain_pulses(self, entries: int, repeats: int, pulses_per_round: int, counted: int) -> str:
        """Say what a wrong number of trigger pulses means; empty when the number is right.

        Args:
            entries: Entries of the sequence.
            repeats: Rounds that were asked for.
            pulses_per_round: Entries that fire TRIG_OUT_2.
            counted: Pulses that were seen.
        """
        expected = pulses_per_round * repeats
        if counted == expected:
            return ""
        sentence = f"{counted} trigger pulses were seen and {expected} expected"
        if counted == expected * entries and self.count_unit is CountUnit.PATTERNS:
            return f"{sentence}: this firmware counts repeats, set firmware = 'rev-f'"
        if counted * entries == expected and self.count_unit is CountUnit.REPEATS:
            return f"{sentence}: this firmware counts patterns, set firmware = 'rev-j'"
        return f"{sentence}: check trigger cable and polarity"


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
