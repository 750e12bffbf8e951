"""What a controller's numbers mean on each stage: the APT protocol counts encoder steps, and stages differ.

Sources: "Thorlabs Motion Controllers Host-Controller Communications Protocol" (APT), section "Conversion between
position, velocity and acceleration values in standard physical units and their equivalent APT values", for the formulae
and the counts; Thorlabs' data sheets for travel and speed. Public drivers disagree about the Z8 family: 34554.96 counts
per mm, the document's (512 counts, a gear of 67.49:1), or 34304 (67:1): 0.73 % of every position. `counts_per_mm` in
[stage] decides.

Here: the table and the conversion. Pure.
"""

from dataclasses import dataclass
from typing import Final

DC_SAMPLE_S: Final = 2048 / 6e6
"""Sampling interval of the servo loop of TDC001 and KDC101, in which speeds and accelerations are counted."""
BRUSHLESS_SAMPLE_S: Final = 102.4e-6
"""That of TBD001, KBD101 and BBD10x to BBD30x."""
_FIXED_POINT: Final = 65536
_STEPPER_SPEED: Final = 53.68
"""Speed units per microstep/s of controllers for stepper motors (KST101, BSC20x, LTS)."""
_STEPPER_ACCELERATION: Final = 90.9
"""Microsteps/s² per acceleration unit of these."""


@dataclass(frozen=True)
class StageModel:
    """One model of stage.

    Args:
        counts_per_mm: Encoder counts, or microsteps, per mm.
        travel_mm: Travel, from 0.
        max_speed_mm_s: Highest speed.
        sample_s: Sampling interval of its controllers' loop; None for a stepper motor.
    """

    counts_per_mm: float
    travel_mm: float
    max_speed_mm_s: float
    sample_s: float | None

    def counts(self, position_mm: float) -> int:
        """Return the nearest position in counts."""
        return round(position_mm * self.counts_per_mm)

    def mm(self, counts: int) -> float:
        """Return a position in mm."""
        return counts / self.counts_per_mm

    @property
    def speed_unit_mm_s(self) -> float:
        """Get the speed of one unit of the protocol."""
        if self.sample_s is None:
            return 1 / (self.counts_per_mm * _STEPPER_SPEED)
        return 1 / (self.counts_per_mm * self.sample_s * _FIXED_POINT)

    @property
    def acceleration_unit_mm_s2(self) -> float:
        """Get the acceleration of one unit of the protocol."""
        if self.sample_s is None:
            return _STEPPER_ACCELERATION / self.counts_per_mm
        return 1 / (self.counts_per_mm * self.sample_s**2 * _FIXED_POINT)


_Z8: Final = 34554.96
STAGES: Final[dict[str, StageModel]] = {
    "MTS25-Z8": StageModel(_Z8, 25.0, 2.4, DC_SAMPLE_S),
    "MTS50-Z8": StageModel(_Z8, 50.0, 2.4, DC_SAMPLE_S),
    "Z812": StageModel(_Z8, 12.0, 2.6, DC_SAMPLE_S),
    "Z825": StageModel(_Z8, 25.0, 2.6, DC_SAMPLE_S),
    "MLS203-X": StageModel(20000.0, 110.0, 250.0, BRUSHLESS_SAMPLE_S),
    "MLS203-Y": StageModel(20000.0, 75.0, 250.0, BRUSHLESS_SAMPLE_S),
    "DDSM50": StageModel(2000.0, 50.0, 500.0, BRUSHLESS_SAMPLE_S),
    "DDSM100": StageModel(2000.0, 100.0, 500.0, BRUSHLESS_SAMPLE_S),
    "DDS220": StageModel(20000.0, 220.0, 300.0, BRUSHLESS_SAMPLE_S),
    "LTS150": StageModel(409600.0, 150.0, 50.0, None),
    "LTS300": StageModel(409600.0, 300.0, 50.0, None),
}
"""Model -> its numbers."""
