"""The largest count of electrons to be expected of a pixel whose mean is known: used in the bounds of noises.

Not here: drawing the counts (`shot_noise`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64

# Bounds assume that noise stays within this many standard deviations: a Gaussian exceeds them once in 1e9.
SIGMAS: Final = 6.0
# Poisson's law has a longer tail for few electrons: n standard deviations plus n^2 / 6 electrons are exceeded with a
# probability of at most exp(-n^2 / 2), for any mean (Bernstein's inequality: Boucheron, Lugosi and Massart,
# Concentration Inequalities, section 2.8).
TAIL_E: Final = SIGMAS**2 / 6


def most_counted_e(mean_e: NDArray[Any] | float) -> F64:
    """Return a limit that counts with these means, electrons, exceed only once in 1e7; 0 for a mean of 0."""
    mean_e = np.asarray(mean_e, dtype=np.float64)
    return np.where(mean_e > 0, mean_e + SIGMAS * np.sqrt(mean_e) + TAIL_E, 0.0)
