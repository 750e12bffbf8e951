"""Where exposures were: by the stage where it reported their paths, and otherwise by what several of them see.

    stage's poses ─► followed corners confirm all of them ─► these
         │           some not, or none ─► pictures' ties ─┬─ agree ─► the stage's
         └────────────────────────────────────────────────┴─ contradict, or none ─► the tie, in the stage's frame and
                                                              unit if any exposure has these

Here: which of the two places each exposure, and what people are told. Not here: either (`placing`, `tie`), their
comparison (`agreement`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.reconstruct.exposures.agreement import confirmed, disagreeing
from gs2ci.reconstruct.exposures.observing import CommonPlace, ObservedExposure, PlacedExposure
from gs2ci.reconstruct.exposures.placing import by_stage
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Ties, tie
from gs2ci.reconstruct.geometry.initialise import Geometry


@dataclass(frozen=True, eq=False)
class CommonPlaces:
    """Exposures in common coordinates.

    Args:
        placed: Those that something ties to others, in the order given.
        left_out: Why the others are not among them.
        notes: What else there is to say.
    """

    placed: tuple[CommonPlace, ...]
    left_out: Findings = ()
    notes: Findings = ()

    def of(self, observed: Sequence[ObservedExposure]) -> tuple[PlacedExposure, ...]:
        """Return the placed ones among observed exposures."""
        by_number = {one.number: one for one in observed}
        return tuple(PlacedExposure(by_number[one.number], one) for one in self.placed)


def places(observed: Sequence[ObservedExposure]) -> CommonPlaces:
    """Bring exposures into common coordinates; leave out what nothing ties.

    Raises:
        GeometryError: There are several, and nothing ties any two of them.
    """
    # Repeats share the path and the depth of the first of them, and its place.
    distinct = [one for one in observed if one.repeats in (None, one.number)]
    if len(distinct) == 1:
        return CommonPlaces(tuple(one.in_common(Similarity.identity()) for one in observed))
    found = _of_distinct(distinct)
    number_of = {one.number: number for number, one in enumerate(distinct)}
    of = [number_of[one.number if one.repeats is None else one.repeats] for one in observed]
    placed = tuple(
        one.in_common(found.known[number], found.geometries.get(number))
        for one, number in zip(observed, of, strict=True)
        if number in found.known
    )
    if len(placed) < 2:
        raise GeometryError(
            f"nothing ties any two of {len(observed)} exposures to each other",
            allowed="exposures whose path a stage reported, or that see the same textured things",
            remedy="capture with a stage in the rig file, or reconstruct each exposure by itself",
        )
    left_out = tuple(
        finding(Code.EXPOSURE_LEFT_OUT, name=one.name, why=found.why.get(number, "nothing ties it to the others"))
        for one, number in zip(observed, of, strict=True)
        if number not in found.known
    )
    moved = tuple(
        finding(Code.EXPOSURE_PLACED_OTHERWISE, name=distinct[number].name, off_px=px)
        for number, px in found.off_px.items()
        if number in found.known
    )
    return CommonPlaces(placed, left_out, moved)


@dataclass(frozen=True, eq=False)
class _Found:
    """Where exposures of distinct paths lie, by their place among these.

    Args:
        known: common_from_own.
        geometries: A better path and depth of those that pictures placed.
        why: Why others are not known.
        off_px: By how much a stage's place of those that it misplaced is off.
    """

    known: dict[int, Similarity]
    geometries: dict[int, Geometry]
    why: dict[int, str]
    off_px: dict[int, float]


def _of_distinct(observed: Sequence[ObservedExposure]) -> _Found:
    """Place exposures by the stage if pictures confirm all that it said, and otherwise by the tie as well."""
    given = by_stage([one.shot for one in observed], [one.geometry for one in observed])
    untied = [one.untied() for one in observed]
    if len(given) == len(observed) and confirmed(untied, given):
        return _Found(given, {}, {}, {})
    ties = tie(untied)
    trusted, off = _trusted(ties, given)
    known = {**_by_pictures(ties, trusted), **trusted}
    # A stage's path is better than one that a decode shows; those tied by pictures have their paths and depths anew.
    better = {number: ties.tied[number].geometry for number in sorted(known) if number not in trusted}
    why = {number: one.why.value for number, one in ties.left_out.items()}
    return _Found({number: known[number] for number in sorted(known)}, better, why, off)


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
