"""Direction-dependent colours during a fit: spherical harmonics are added degree by degree.

A Gaussian starts with one colour. Harmonics of higher degree are added later, starting at zero, so that colours do not
explain what positions and shapes can explain (Kerbl et al. 2023, section 7.1).

Here: the settings. Not here: the harmonics (`gs2ci.render.harmonics`), their step (`optimiser/gaussians.py`).
"""

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from gs2ci.core.bounds import Bounded
from gs2ci.render.harmonics import DEGREE_MAX


@dataclass(frozen=True)
class ColourSettings(Bounded):
    """Which spherical harmonics are fitted, and from when.

    Args:
        degree: The highest; 0 is one colour for each Gaussian in all directions.
        every: Share of the schedule between degrees: degree 1 is added after it, degree 2 after twice as much.
    """

    degree: Annotated[int, Field(ge=0, le=DEGREE_MAX)] = 0
    every: Annotated[float, Field(gt=0, le=1)] = 0.05

    def at(self, share: float) -> int:
        """Return the degree of colours after a share of the schedule."""
        # The quotient of two shares of a schedule may be a whole number up to rounding.
        return min(self.degree, math.floor(share / self.every + 1e-9))
