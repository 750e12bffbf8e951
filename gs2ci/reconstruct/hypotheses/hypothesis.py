"""What is tried for one measurement, and what came of it.

Here: the records. Not here: who proposes hypotheses (a file each), their fits (`fitting`), which go on (`race`).
"""

from dataclasses import dataclass, replace
from enum import StrEnum

from gs2ci.core.arrays import F32
from gs2ci.core.run_figures import RaceEntry
from gs2ci.reconstruct.first_look import FirstLook


class Origin(StrEnum):
    """Where a hypothesis comes from; the values stand in reports."""

    FIRST = "first look"
    AGAIN = "second look"
    MATCHES = "wide"
    COMPANION = "other density rule"
    MOVING = "moving from the first"


class RaceOutcome(StrEnum):
    """What became of a hypothesis; the values stand in reports."""

    LED = "taken"
    AVERAGED = "counts in the mean"
    LESS = "explains less"
    BEHIND = "far behind after a quarter of its schedule"
    NOT_NEEDED = "no longer needed"
    FAILED = "diverged"


@dataclass(frozen=True)
class OrderFound:
    """What is known of the order of depth, near against far.

    Args:
        errors: Where nothing settles it: by how many standard errors the likelier one, which is used, is preferred.
            None: a stage gave it, tracks are sure of it, or there is no depth.
    """

    errors: float | None = None

    @property
    def is_open(self) -> bool:
        """Get whether near and far may be exchanged."""
        return self.errors is not None


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A path, a start of the depths, their order, and whether things move.

    Args:
        origin: Where it comes from.
        look: The measurement, its decoded views, path and depth.
        views: They give the first Gaussians colours, and motion, [N, H, W, C].
        order: Of its depths.
        moves: Whether the scene may move.
        member: Fits from one start differ by this number: in density rule, seed and a displacement of their Gaussians.
    """

    origin: Origin
    look: FirstLook
    views: F32
    order: OrderFound = OrderFound()
    moves: bool = False
    member: int = 0

    def companion(self, member: int) -> "Hypothesis":
        """Return the same hypothesis for another member of the ensemble."""
        return replace(self, origin=Origin.COMPANION, member=member)


@dataclass(frozen=True)
class RaceEvidence(RaceEntry):
    """What came of a hypothesis."""

    hypothesis: Origin
    outcome: RaceOutcome
