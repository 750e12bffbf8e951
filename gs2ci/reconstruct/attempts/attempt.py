"""An attempt at one measurement: some fits from one beginning, and how they are made.

Here: the two records. Not here: the fitting (`fits.py`), which attempts are made and which is taken (`choice.py`).
"""

from dataclasses import dataclass

from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse import CoarseFit
from gs2ci.reconstruct.fit.ensemble import Ensemble, Member
from gs2ci.reconstruct.fit.stopping import Rival
from gs2ci.reconstruct.geometry.initialise import Geometry


@dataclass(frozen=True)
class Attempt:
    """Fits, and the look and the geometry that they began with.

    Args:
        look: What had been found.
        geometry: As it was fitted from.
        fits: The leader's, and those of its companions.
        ensemble: Of these.
        later: The companions that have not been fitted: an attempt that may be replaced makes one fit at first.
    """

    look: FirstLook
    geometry: Geometry
    fits: tuple[CoarseFit, ...]
    ensemble: Ensemble
    later: tuple[Member, ...] = ()


@dataclass(frozen=True)
class How:
    """How an attempt is made.

    Args:
        moving: Whether the scene may move.
        alone: Whether the leader is fitted alone at first.
        rival: A fit that those of the attempt have to keep up with.
    """

    moving: bool = False
    alone: bool = False
    rival: Rival | None = None
