"""A sensor's data sheet, in EMVA 1288 terms, and the effects that it implies. For exposures and twins.

Not here: the effects themselves (`effects`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.effects.read_noise import ReadNoise
from gs2ci_sims.effects.shot_noise import ShotNoise

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
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
        self.effects()  # full well, noise and bits are checked there
        if not self.electrons_per_dn > 0 or not 0 < self.quantum_efficiency <= 1:
            raise InputError(
                f"{self.electrons_per_dn} e/DN, quantum efficiency {self.quantum_efficiency}",
                allowed="electrons_per_dn > 0, quantum_efficiency in (0, 1]",
            )
        if not 0 <= self.black_level_dn < 2**self.bits - 1:
            raise InputError(f"black level {self.black_level_dn} DN", allowed=f"0 to {2**self.bits - 2}")

    def effects(self) -> tuple[Effect, ...]:
        """List what this sensor does to the light, with its figures."""
        return (
            ShotNoise(),
            FullWell(self.full_well_e),
            ReadNoise(self.read_noise_e),
            Quantisation(self.bits),
        )

    def dn_from_electrons(self, charge_e: F64) -> F64:
        """Convert charge to readings before quantisation: µ_y = µ_y.dark + K µ_e (Release 3.1, section 2.1)."""
        return self.black_level_dn + charge_e / self.electrons_per_dn

    def electrons_from_dn(self, reading_dn: F64) -> F64:
        """Convert readings back to electrons above black."""
        return (reading_dn - self.black_level_dn) * self.electrons_per_dn

    @property
    def saturation_dn(self) -> float:
        """Get the reading from which on a pixel may be clipped: the well's, less 4 σ of read noise, or the top."""
        well_e = self.full_well_e - 4 * self.read_noise_e
        return min(self.black_level_dn + well_e / self.electrons_per_dn, 2.0**self.bits - 1)
