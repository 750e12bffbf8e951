"""A sensor's data sheet, in EMVA 1288 terms, the figures of `RigFigures.sensor`.

Not here: the effects that it implies (`effects`, listed by `light_path.sensor_effects`).
"""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class SensorFigures:
    """A linear sensor. The defaults are a Sony IMX255-class one (mvBlueFOX3 manual, p. 861).

    Args:
        full_well_e: Saturation capacity in electrons.
        read_noise_e: Temporal dark noise in electrons.
        bits: Of the converter.
        electrons_per_dn: Conversion factor; EMVA's system gain K is its inverse. The default lets the full well
            end 64 DN below the converter's range, so that the well clips first.
        black_level_dn: Reading of an empty pixel.
        quantum_efficiency: Electrons per photon, in (0, 1].
    """

    full_well_e: float = 10_700.0
    read_noise_e: float = 2.9
    bits: int = 12
    electrons_per_dn: float = 2.7
    black_level_dn: float = 64.0
    quantum_efficiency: float = 0.64

    def __post_init__(self) -> None:
        if not self.full_well_e > 0 or not 0 <= self.read_noise_e < np.inf or not 1 <= self.bits <= 32:
            raise InputError(
                f"full well {self.full_well_e} e, read noise {self.read_noise_e} e, {self.bits} bits",
                allowed="full_well_e > 0, read_noise_e >= 0, bits 1 to 32",
            )
        if not 0 < self.electrons_per_dn < np.inf or not 0 < self.quantum_efficiency <= 1:
            raise InputError(
                f"{self.electrons_per_dn} e/DN, quantum efficiency {self.quantum_efficiency}",
                allowed="electrons_per_dn > 0 and finite, quantum_efficiency in (0, 1]",
            )
        if not 0 <= self.black_level_dn < 2**self.bits - 1:
            raise InputError(f"black level {self.black_level_dn} DN", allowed=f"0 to {2**self.bits - 2}")

    def dn_from_electrons(self, charge_e: F64) -> F64:
        """Convert charge to readings before quantisation: µ_y = µ_y.dark + K µ_e (Release 3.1, section 2.1)."""
        return self.black_level_dn + charge_e / self.electrons_per_dn

    def electrons_from_dn(self, reading_dn: F64) -> F64:
        """Convert readings back to electrons above black."""
        return (reading_dn - self.black_level_dn) * self.electrons_per_dn
