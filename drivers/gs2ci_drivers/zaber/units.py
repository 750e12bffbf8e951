"""Conversion between millimetres and Zaber's numbers. Pure."""

from dataclasses import dataclass

SPEED_SCALE = 1.6384
"""Speed data per microstep/s on most firmware (reference 3.1, unconfirmed for every model: a setting)."""
ACCELERATION_DIVISOR = 1e4
"""Acceleration data is in units of this many speed data per second."""

NO_RAMP_DATA = 10**6
"""Steeper than any motor; it keeps the run-up of a sweep finite if the device has no ramp."""


@dataclass(frozen=True)
class Units:
    """Conversions for one axis.

    Args:
        microstep_mm: Travel of one microstep, from the data sheet.
        speed_scale: Speed data per microstep/s.
    """

    microstep_mm: float
    speed_scale: float = SPEED_SCALE

    def steps(self, position_mm: float) -> int:
        """Return the nearest position in microsteps."""
        return round(position_mm / self.microstep_mm)

    def mm(self, steps: int) -> float:
        """Return a position in mm."""
        return steps * self.microstep_mm

    def speed_data(self, speed_mm_s: float) -> int:
        """Return the nearest speed data, at least 1 (0 has another meaning for some firmware)."""
        return max(1, round(speed_mm_s / self.microstep_mm * self.speed_scale))

    def speed_mm_s(self, data: int) -> float:
        """Return a speed in mm/s."""
        return data / self.speed_scale * self.microstep_mm

    def acceleration_mm_s2(self, data: int) -> float:
        """Return an acceleration in mm/s²; data 0 means no ramp and counts as a very steep one."""
        return (data or NO_RAMP_DATA) * ACCELERATION_DIVISOR / self.speed_scale * self.microstep_mm
