"""What a fit of several exposures keeps on a disk, so that it can go on after it was killed.

Here: the records, and what a fit asks of whoever keeps them. Not here: files (`exposures.unfinished`), when a fit keeps
what (`stage.py`, `state.py`).
"""

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Finding
from gs2ci.core.run_records import CurvePoint
from gs2ci.reconstruct.fit.optimiser.adam import AdamState
from gs2ci.reconstruct.fit.optimiser.poses import PosesState
from gs2ci.reconstruct.fit.surfaces.surfaces import Surfaces
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class KeptScene:
    """A state to go back to.

    Args:
        scene: The Gaussians.
        twists: Of each exposure.
        iteration: When it was.
        surfaces: By which search those of each exposure were found; None: there are none.
        outside: Which Gaussians lie beyond the borders of all views.
        searches: How many searches were still to come.
    """

    scene: Gaussians
    twists: tuple[Tensor, ...]
    iteration: int
    surfaces: tuple[int | None, ...]
    outside: Tensor | None
    searches: int


@dataclass(frozen=True, eq=False)
class KeptState:
    """What iterations change: the present state, and what further steps follow from.

    Args:
        now: The present state.
        moments: Of the Gaussians' parameters.
        poses: Of each exposure.
        split: Whether masks have their moments.
        screen: Statistics since the density rule was last applied.
        generator: State of the generator of draws.
        bound: The population's bound, if it is in force by now.
    """

    now: KeptScene
    moments: dict[str, AdamState]
    poses: tuple[PosesState, ...]
    split: bool
    screen: tuple[Tensor, Tensor, Tensor]
    generator: Tensor
    bound: int | None


@dataclass(frozen=True, eq=False)
class KeptFit:
    """A whole fit between two iterations; the loop's own figures are named as there.

    Args:
        state: What iterations change.
        best: The best state so far.
        iteration: How many iterations are done.
        stopped: Why it ended; None: it has not.
        notes: Its findings.
        curve: Its looks.
        watch: Of held-out pixels.
        damping: On steps.
        rollbacks: How often it was set back.
        first_loss: None before the first.
        least_loss: Since the density rule was last applied.
    """

    state: KeptState
    best: KeptScene
    iteration: int
    stopped: Finding | None
    notes: tuple[Finding, ...]
    curve: tuple[CurvePoint, ...]
    watch: dict[str, float]
    damping: float
    rollbacks: int
    first_loss: float | None
    least_loss: float


@dataclass(frozen=True, eq=False)
class KeptSearch:
    """What a search for surfaces found in one exposure.

    Args:
        at: The iteration and the rollbacks before the search.
        surfaces: Without prepared masks; None: nothing was found.
        shown: The views in which they were found, by number.
    """

    at: tuple[int, int]
    surfaces: Surfaces | None
    shown: dict[int, F32]


class Keeper(Protocol):
    """Keeps a fit."""

    def is_due(self) -> bool:
        """Tell whether the fit is to be kept now."""

    def keep(self, fit: KeptFit) -> None:
        """Keep a fit in place of the one before."""

    def kept(self) -> KeptFit | None:
        """Return what was kept before this program began; None: nothing."""

    def keep_search(self, search: int, exposure: int, found: KeptSearch) -> None:
        """Keep what a search found."""

    def kept_search(self, search: int, exposure: int) -> KeptSearch | None:
        """Return what was kept of a search; None: nothing."""
