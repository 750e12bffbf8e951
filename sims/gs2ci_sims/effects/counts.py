"""The largest count of electrons to be expected of a pixel whose mean is known: used in the bounds of noises.

Not here: drawing the counts (`shot_noise`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64

# Standard deviations of noise that a reading is taken to stay within: a Gaussian exceeds them once in 1e9.
SIGMAS: Final = 6.0
# Poisson's law has a longer tail where few electrons are counted: n standard deviations and n^2 / 6 electrons are
# exceeded with a probability of exp(-n^2 / 2) at most, for any mean (Bernstein's inequality: Boucheron, Lugosi and
# Massart, Concentration Inequalities, section 2.8).
TAIL_E: Final = SIGMAS**2 / 6


def most_counted_e(mean_e: NDArray[Any] | float) -> F64:
    """Return what counts of these means, electrons, do not exceed, but once in 1e7; of nothing, nothing."""
    mean_e = np.asarray(mean_e, dtype=np.float64)
    return np.where(mean_e > 0, mean_e + SIGMAS * np.sqrt(mean_e) + TAIL_E, 0.0)
