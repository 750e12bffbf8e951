"""Where exposures were: by the stage where it reported their paths, and otherwise by what several of them see.

    stage's poses ─┬─ agree with what exposures see ─► these
    pictures' ties ┘  contradicted, or none ─► the tie, in the stage's frame and unit if any exposure has these

Here: which of the two places each exposure, and what people are told. Not here: either (`placing`, `tie`), their
comparison (`agreement`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.exposures.agreement import disagreeing
from gs2ci.reconstruct.exposures.observing import ObservedExposure, PlacedExposure
from gs2ci.reconstruct.exposures.placing import by_stage
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Ties, tie


@dataclass(frozen=True, eq=False)
class CommonPlaces:
    """Exposures in common coordinates.

    Args:
        placed: Those that something ties to others, in the order given.
        left_out: Why the others are not among them.
        notes: What else there is to say.
    """

    placed: tuple[PlacedExposure, ...]
    left_out: tuple[Finding, ...] = ()
    notes: tuple[Finding, ...] = ()


def places(observed: Sequence[ObservedExposure]) -> CommonPlaces:
    """Bring exposures into common coordinates; leave out what nothing ties.

    Raises:
        GeometryError: There are several, and nothing ties any two of them.
    """
    if len(observed) == 1:
        return CommonPlaces((observed[0].in_common(Similarity.identity()),))
    ties = tie([one.untied() for one in observed])
    given = by_stage([one.shot for one in observed], [one.geometry for one in observed])
    trusted, off = _trusted(ties, given)
    known = {**_by_pictures(ties, trusted), **trusted}
    if len(known) < 2:
        raise GeometryError(
            f"nothing ties any two of {len(observed)} exposures to each other",
            allowed="exposures whose path a stage reported, or that see the same textured things",
            remedy="capture with a stage in the rig file, or reconstruct each exposure by itself",
        )
    # A stage's path is better than one that a decode shows; those tied by pictures have their paths and depths anew.
    placed = tuple(
        observed[number].in_common(known[number], None if number in trusted else ties.tied[number].geometry)
        for number in sorted(known)
    )
    why = {number: one.why.value for number, one in ties.left_out.items()}
    left_out = tuple(
        finding(Code.EXPOSURE_LEFT_OUT, name=one.name, why=why.get(number, "nothing ties it to the others"))
        for number, one in enumerate(observed)
        if number not in known
    )
    moved = tuple(
        finding(Code.EXPOSURE_PLACED_OTHERWISE, name=observed[number].name, off_px=px)
        for number, px in off.items()
        if number in known
    )
    return CommonPlaces(placed, left_out, moved)


def _trusted(ties: Ties, given: dict[int, Similarity]) -> tuple[dict[int, Similarity], dict[int, float]]:
    """Return the places by a stage that what exposures see does not contradict; and by how many px the others are off.

    The worst goes first: beside a wrong place, right ones of its neighbours seem wrong too.
    """
    trusted, off = dict(given), dict[int, float]()
    while wrong := disagreeing(ties, trusted):
        worst = max(wrong, key=lambda number: wrong[number])
        off[worst] = wrong[worst]
        del trusted[worst]
    return trusted, off


def _by_pictures(ties: Ties, trusted: dict[int, Similarity]) -> dict[int, Similarity]:
    """Return common_from_own of all that pictures tie, in the coordinates of those that a stage placed."""
    tied = ties.tied
    anchors = [number for number in tied if number in trusted]
    if trusted and not anchors:
        return {}
    found = {}
    for number, one in tied.items():
        near = next((partner for partner in one.partners if partner in anchors), anchors[0] if anchors else None)
        frame = Similarity.identity() if near is None else trusted[near].after(tied[near].common_from_own.inverse)
        found[number] = frame.after(one.common_from_own)
    return found
