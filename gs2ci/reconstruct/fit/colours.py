"""Direction-dependent colours during a fit: spherical harmonics are added degree by degree.

A Gaussian starts with one colour. Harmonics of higher degree are added later, starting at zero, so that colours do not
explain what positions and shapes can explain (Kerbl et al. 2023, section 7.1).

Here: the settings. Not here: the harmonics (`gs2ci.render.harmonics`), their step (`optimiser.py`).
"""

import math
from dataclasses import dataclass

from gs2ci.core.errors import InputError
from gs2ci.render.harmonics import DEGREE_MAX

# Tolerance for rounding: the quotient of two shares of a schedule may be a whole number up to rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ColourSettings:
    """Which spherical harmonics are fitted, and from when.

    Args:
        degree: The highest; 0 is one colour for each Gaussian in all directions.
        every: Share of the schedule between degrees: degree 1 is added after it, degree 2 after twice as much.
    """

    degree: int = 0
    every: float = 0.05

    def check(self) -> "ColourSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: The degree is not 0 to 3, or the share not above 0 and at most 1.
        """
        if not 0 <= self.degree <= DEGREE_MAX:
            raise InputError(f"spherical harmonics of degree {self.degree}", allowed=f"0 to {DEGREE_MAX}")
        if not 0 < self.every <= 1:
            raise InputError(
                f"spherical harmonics of one degree more after each {self.every:g} of the schedule",
                allowed="a share above 0 and at most 1",
            )
        return self

    def at(self, share: float) -> int:
        """Return the degree of colours after a share of the schedule."""
        return min(self.degree, math.floor(share / self.every + _ROUNDING))
