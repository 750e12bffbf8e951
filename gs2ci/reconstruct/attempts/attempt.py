"""An attempt at one measurement: some fits from one beginning, and how they are made.

Here: the two records. Not here: the fitting (`fits.py`), which attempts are made and which is taken (`choice.py`).
"""

from dataclasses import dataclass

from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseRun
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
        later: The companions that have not been fitted: an attempt that may be replaced begins with its leader alone.
        led: The leader's run where it was left before its end; `fits` has what it had come to.
    """

    look: FirstLook
    geometry: Geometry
    fits: tuple[CoarseFit, ...]
    ensemble: Ensemble
    later: tuple[Member, ...] = ()
    led: CoarseRun | None = None


@dataclass(frozen=True)
class How:
    """How an attempt is made.

    Args:
        moving: Whether the scene may move.
        alone: Whether the leader is fitted alone at first, and left before its end.
        rival: A fit that those of the attempt have to keep up with.
    """

    moving: bool = False
    alone: bool = False
    rival: Rival | None = None
