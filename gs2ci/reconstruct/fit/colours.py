"""How far colours may change with the direction of sight while Gaussians are fitted: degree by degree.

A Gaussian begins with one colour. Harmonics of a further degree come in at zero once the lower ones have had their
time, so that what places and shapes can explain is not first explained by colours (Kerbl et al. 2023, section 7.1).

Here: the settings. Not here: the harmonics (`gs2ci.render.harmonics`), their step (`optimiser.py`).
"""

import math
from dataclasses import dataclass

from gs2ci.core.errors import InputError
from gs2ci.render.harmonics import DEGREE_MAX

# A share of a schedule is a quotient of integers, and so is its quotient by another one, but for rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ColourSettings:
    """Which spherical harmonics there are, and from when.

    Args:
        degree: The highest; 0 is one colour for each Gaussian, whoever sees it.
        every: Share of the schedule between degrees: degree 1 comes in after it, degree 2 after twice as much.
    """

    degree: int = 0
    every: float = 0.05

    def check(self) -> "ColourSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: The degree is not 0 to 3, or the share not above 0 and at most 1.
        """
        if not 0 <= self.degree <= DEGREE_MAX or not 0 < self.every <= 1:
            raise InputError(
                f"spherical harmonics of degree {self.degree}, one more after each {self.every:g} of the schedule",
                allowed=f"a degree of 0 to {DEGREE_MAX} and a share above 0 and at most 1",
            )
        return self

    def at(self, share: float) -> int:
        """Return the degree that colours have when a share of the schedule is done."""
        return min(self.degree, math.floor(share / self.every + _ROUNDING))
