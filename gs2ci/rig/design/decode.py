"""How well one exposure's views can be told apart before path and depth are known: the decode, from which both begin.

Each exposure is decoded by itself, its N views sharing one reading at each pixel. The differences between views are
then unknown textures: a view is seen through the other views' errors, which are as large as its own. With
ν = σ²/(ρ(1 − ρ)) + (N − 1) e the power of the noise through which a view's differences are seen, σ² that of a reading,
ρ the open share, their error is Wiener's, e = ⟨S ν/(S + ν)⟩ over the spectrum S of the differences; the e that both
agree on is taken.

Here: this. Not here: what readings tell once the scene moves as a whole (`place`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.rig.design.place import REPRESENTED, Place, Readings, Texture

KEPT: Final = 0.2
"""The share of a decode's power of error that a fitted scene keeps: the largest that did not make the order of captures
of the scenes planes and blocks worse."""
_SIDE_PX: Final = 32
_ROUNDS: Final = 60
_LEAST: Final = 1e-9


def error_of_decode(places: Sequence[Place], of: Readings, prior: Texture, brightness: float) -> float:
    """Return the mean power of the error of the differences between decoded views; full scale 1.

    Args:
        places: All over the picture.
        of: The readings.
        prior: What is known of textures.
        brightness: Mean of the views.
    """
    spectrum = _spectrum(prior.alike)
    return float(np.mean([_error(place.flows, of, prior, brightness, spectrum) for place in places]))


def _error(flows: F64, of: Readings, prior: Texture, brightness: float, spectrum: F64) -> float:
    count, share = len(flows), float(np.clip(of.masks.mean(), 1e-3, 1 - 1e-3))
    apart_px = np.linalg.norm(flows[:, None] - flows[None], axis=-1)
    # Views that hardly move differ little.
    differing = prior.variance * float(1 - (prior.alike**apart_px).mean())
    alike = float(np.exp(-(apart_px**2) / (2 * factors.alike_px**2)).mean())
    charge_e = count * share * brightness * of.full_scale_e
    lacking = (REPRESENTED * of.element) ** 2 * ((count * share) ** 2 * alike + count * share * (1 - share))
    noise = (charge_e + of.dark_e2) / of.full_scale_e**2 + lacking
    error = differing
    for _ in range(_ROUNDS):
        through = noise / (share * (1 - share)) + (count - 1) * error
        error = float(np.mean(differing * spectrum * through / (differing * spectrum + through)))
    return error


def _spectrum(alike: float) -> F64:
    """Return the power of a texture of variance 1 at each frequency of a square."""
    far = np.minimum(np.arange(_SIDE_PX), _SIDE_PX - np.arange(_SIDE_PX))
    return np.maximum(np.fft.fft2(alike ** (far[:, None] + far)).real, _LEAST)
