"""An attempt at one measurement: fits from one common start, and how they are made.

Here: the two records. Not here: the fitting (`fits.py`), which attempts are made and which is chosen (`choice.py`).
"""

from dataclasses import dataclass

from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse import CoarseFit
from gs2ci.reconstruct.fit.ensemble import Ensemble, Member
from gs2ci.reconstruct.fit.stopping import Rival
from gs2ci.reconstruct.geometry.initialise import Geometry


@dataclass(frozen=True)
class Attempt:
    """Fits, and the first look and the geometry that they started from.

    Args:
        look: The first look.
        geometry: The geometry at the start of the fits.
        fits: The leader's fit, and those of its companions.
        ensemble: Their combination.
        later: The companions not fitted yet: an attempt that may be replaced makes one fit at first.
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
        rival: A fit of another attempt; fits that fall far behind it are stopped.
    """

    moving: bool = False
    alone: bool = False
    rival: Rival | None = None
