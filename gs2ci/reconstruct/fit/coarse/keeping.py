"""What a fit of several exposures keeps on a disk, so that it can go on after it was killed.

Here: the records, and what a fit asks of whoever keeps them. Not here: files (`exposures.unfinished`), when a fit keeps
what (`stage.py`, `state.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Finding, Findings
from gs2ci.core.run_figures import CurvePoint
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.optimiser.poses import PosesState
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, Surfaces
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A state to go back to.

    Args:
        scene: The Gaussians.
        twists: Of each exposure.
        iteration: When it was.
        surfaces: Those of each exposure, on the disk the number of the search that found them; None: there are none.
        outside: Which Gaussians lie beyond the borders of all views.
        searches: Those that were still to come.
    """

    scene: Gaussians
    twists: tuple[Tensor, ...]
    iteration: int
    surfaces: tuple[Surfaces | int | None, ...]
    outside: Tensor | None
    searches: tuple[Search, ...]


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

    now: Snapshot
    moments: dict[str, Adam]
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
    best: Snapshot
    iteration: int
    stopped: Finding | None
    notes: Findings
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


def kept_scene(state: Snapshot, searches: Sequence[Search]) -> Snapshot:
    """Return a state for the disk, on the host.

    Args:
        state: It.
        searches: Those of the fit, in their order.
    """
    found = tuple(searches.index(one.search) if isinstance(one, Surfaces) else None for one in state.surfaces)
    return replace(state, scene=state.scene.map(Tensor.cpu), surfaces=found)


def scene_again(kept: Snapshot, renderers: Sequence[ShotRenderer], keeper: Keeper) -> Snapshot:
    """Return the state that was kept; its Gaussians lie on the host.

    Args:
        kept: It.
        renderers: Of each exposure.
        keeper: Has kept what the searches found.
    """
    surfaces: list[Surfaces | None] = []
    for exposure, (number, renderer) in enumerate(zip(kept.surfaces, renderers, strict=True)):
        found = keeper.kept_search(number, exposure) if isinstance(number, int) else None
        bare = None if found is None else found.surfaces
        surfaces.append(None if bare is None else bare.with_masks(renderer))
    return replace(kept, surfaces=tuple(surfaces))
