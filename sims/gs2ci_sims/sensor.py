"""A sensor's data sheet, in EMVA 1288 terms, the figures of `RigFigures.sensor`.

Not here: the effects that it implies (`effects`, listed by `light_path.sensor_effects`).
"""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative, Positive
from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class SensorFigures(BoundedRecord):
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

    full_well_e: Annotated[float, Field(gt=0)] = 10_700.0
    read_noise_e: NotNegative = 2.9
    bits: Annotated[int, Field(ge=1, le=32)] = 12
    electrons_per_dn: Positive = 2.7
    black_level_dn: float = 64.0
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] = 0.64

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.black_level_dn < 2**self.bits - 1:
            raise InputError(f"black level {self.black_level_dn} DN", allowed=f"0 to {2**self.bits - 2}")

    def dn_from_electrons(self, charge_e: F64) -> F64:
        """Convert charge to readings before quantisation: µ_y = µ_y.dark + K µ_e (Release 3.1, section 2.1)."""
        return self.black_level_dn + charge_e / self.electrons_per_dn
