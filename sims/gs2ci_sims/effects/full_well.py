"""Full well: a pixel holds only so many electrons."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Stage

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class FullWell:
    """Clip each pixel's charge at its capacity; what is beyond is lost (no blooming).

    The saturation capacity µ_e.sat of EMVA Standard 1288, Release 3.1, section 2.4.

    Args:
        capacity_e: Electrons, more than 0.
    """

    name: ClassVar[str] = "full_well"
    stage: ClassVar[Stage] = Stage.CHARGE

    capacity_e: float

    def __post_init__(self) -> None:
        if not self.capacity_e > 0:
            raise InputError(f"full well of {self.capacity_e} electrons", allowed="more than 0")

    def apply(self, signal: F64, rng: np.random.Generator) -> F64:
        """Clip electrons [H, W, C]."""
        return np.minimum(signal, self.capacity_e)
