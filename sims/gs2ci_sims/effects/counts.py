"""The largest count of a pixel whose mean is known, and the largest sum of random terms: used in the bounds of noises.

Not here: drawing the counts (`noises.ShotNoise`).
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


def most_in_sum(mean: float, variance: float, scale: float) -> float:
    """Return a limit that a sum of independent random terms exceeds only once in 1e7.

    The sum exceeds mean + n sqrt(variance) + n^2 / 2 scale with a probability of at most exp(-n^2 / 2) if it is
    sub-gamma on the right tail (Boucheron, Lugosi and Massart, Concentration Inequalities, section 2.4):

    - terms between 0 and b: the sum of their mean squares as variance, b / 3 as scale (Bernstein, section 2.8);
    - squares of standard normal numbers with weights a: 2 sum(a^2) and 2 max(a) (section 2.4 as well; Laurent and
      Massart, Annals of Statistics 28 (2000), lemma 1).
    """
    return float(mean + SIGMAS * np.sqrt(variance) + SIGMAS**2 / 2 * scale)
