"""Photon shot noise: light comes in grains."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_sims.effects.base import Stage

F64 = NDArray[np.float64]

# Above this mean the normal law with variance = mean differs from Poisson's by less than one part in 10^5 of its
# standard deviation (skewness 1/sqrt(mean)), while numpy's Poisson refuses means near 2^63.
POISSON_MAX_E: Final = 1e10


@dataclass(frozen=True)
class ShotNoise:
    """Draw each pixel's electrons from the Poisson law of its mean.

    Absorbed photons are a thinned Poisson process, hence Poisson themselves: variance = mean (EMVA Standard 1288,
    Release 3.1, section 2.2). Saturation comes later along the path.
    """

    name: ClassVar[str] = "shot_noise"
    stage: ClassVar[Stage] = Stage.CHARGE

    def apply(self, signal: F64, rng: np.random.Generator) -> F64:
        """Turn mean electrons [H, W, C] into counted ones."""
        counted = rng.poisson(np.minimum(signal, POISSON_MAX_E)).astype(np.float64)
        bright = signal > POISSON_MAX_E
        if bright.any():
            mean = signal[bright]
            counted[bright] = mean + np.sqrt(mean) * rng.standard_normal(mean.shape)
        return counted
