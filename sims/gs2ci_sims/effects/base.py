"""What an effect is. For this package.

An effect is a frozen dataclass of its parameters. Its presence in a light path switches it on; there is no flag.
It turns the signal at its stage into another of the same meaning and draws from no generator but the one it is
handed, which belongs to it alone.
"""

import enum
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]


@enum.unique
class Stage(enum.Enum):
    """Where along the light path an effect acts, and what the signal is there."""

    EXPOSURE = "slices of time, [N, S, 2]: start and stop in seconds of the S slices in which mask n is exposed"
    CHARGE = "electrons in each pixel, [H, W, C]"
    READOUT = "readings, [H, W, C], DN"


class Effect(Protocol):
    """One physical effect."""

    name: ClassVar[str]
    stage: ClassVar[Stage]

    def apply(self, signal: F64, rng: np.random.Generator) -> F64:
        """Return the signal with the effect; never changes its argument."""
        ...
