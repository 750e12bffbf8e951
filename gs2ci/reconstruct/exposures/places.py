"""Where exposures were: by the stage where it reported their paths, and otherwise by what several of them see.

    stage's poses ─► followed corners confirm all of them ─► these
         │           some not, or none ─► pictures' ties ─┬─ agree ─► the stage's
         └────────────────────────────────────────────────┴─ contradict, or none ─► the tie, in the stage's frame and
                                                              unit if any exposure has these; one that nothing ties,
                                                              and that shows nothing of what it should, is left out

Here: which of the two places each exposure, their comparison, and what people are told. Not here: either (`observing`,
`tie`).
"""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from gs2ci.core.cameras import in_world
from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.reconstruct.exposures.corners import followed
from gs2ci.reconstruct.exposures.observing import CommonPlace, ObservedExposure, PlacedExposure, by_stage
from gs2ci.reconstruct.exposures.pairs import LEAST_FOUND, LEAST_SHARE, projected
from gs2ci.reconstruct.exposures.pictures import depths_of, pictures_of
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Pictures, Tied, Ties, Untied, tie
from gs2ci.reconstruct.geometry.depth.view_depths import grid, project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.motion import rays

# Whether a stage's report of where exposures were agrees with what several of them see.
#
# A stage that lost steps between two exposures reports every path rightly and the place of one wrongly. Each exposure
# is compared with those that see the same things, pair by pair, so that a wrong one does not accuse the right ones.

# A place disagrees if neighbours see what both see displaced by more than this share of the picture's width: at 128 px
# eight. Ties of decoded rooms are off by up to 5 px where exposures lie in a row (`python -m tests.benchmarks ties`).
LIMIT_SHARE: Final = 0.06
"""Displacement, as a share of the picture's width, from which on a place disagrees."""
# Points are compared at every so many pixels.
_EVERY_PX: Final = 8


def displacements_px(ties: Ties, given: Mapping[int, Similarity]) -> dict[int, float]:
    """Return how far apart given places and ties put what exposures see, in the pictures of those that see the same.

    Args:
        ties: Of all exposures.
        given: common_from_own of some of them, by index, in any common coordinates (`placing.by_stage`).

    Returns:
        For each exposure that is tied and given, and has such partners, the median over them of the median
        displacement, px; by index.
    """
    tied, found = ties.tied, {}
    for number in sorted(set(tied) & set(given)):
        partners = [other for other in tied[number].partners if other in given]
        if partners:
            off = [_displaced_px((tied[number], tied[k]), (given[number], given[k])) for k in partners]
            found[number] = float(np.median(off))
    return found


def confirmed(exposures: Sequence[Untied], given: Mapping[int, Similarity]) -> bool:
    """Tell whether what neighbours see confirms the given places of all exposures: a small part of the work of a tie.

    The corners of one are followed into a neighbour's picture, warped onto it along the given places. Along wrong ones
    few are found. Neighbours of which hardly any corner should be seen by both say nothing, and confirm nothing.

    Args:
        exposures: All of them.
        given: common_from_own of all, by index.
    """
    pictures = _pictures(exposures)
    centres = {number: one.points(pictures(number)[0].centre) for number, one in given.items()}
    joined = {min(given)}
    # The nearest exposure that is not joined yet is compared with the nearest that is, so that all hang together.
    while len(joined) < len(given):
        pairs = [(one, other) for one in joined for other in given if other not in joined]
        one, other = min(pairs, key=lambda pair: float(np.linalg.norm(centres[pair[0]] - centres[pair[1]])))
        if not _sees_the_same((pictures(one), pictures(other)), given[other].inverse.after(given[one])):
            return False
        joined.add(other)
    return True


def _pictures(exposures: Sequence[Untied]) -> Callable[[int], Pictures]:
    """Return what gives the pictures of an exposure by its index: they are made when they are asked for, once."""
    return cache(lambda number: pictures_of(exposures[number].views, exposures[number].geometry))


def _sees_the_same(pictures: tuple[Pictures, Pictures], other_from_one: Similarity) -> bool:
    """Tell whether corners of the second are found where they should be in the pictures of the first."""
    matches, visible = followed(*pictures, other_from_one)
    if len(matches) < max(LEAST_FOUND, LEAST_SHARE * visible):
        return False
    seen_from = [pictures[0][k] for k in matches.pictures[:, 0]]
    poses, intrinsics = (
        np.stack([getattr(one, name) for one in seen_from]) for name in ("world_to_camera", "intrinsics")
    )
    places, _ = projected(other_from_one.inverse.points(matches.other), poses, intrinsics)
    limit_px = LIMIT_SHARE * pictures[0][0].inverse_depth.shape[1]
    return bool(np.median(np.linalg.norm(places - matches.at_one, axis=1)) <= limit_px)


def disagreeing(ties: Ties, given: Mapping[int, Similarity]) -> dict[int, float]:
    """Return the exposures whose given place disagrees with what they see, with their displacement in px, by index.

    Arguments as of `displacements_px`. If two exposures alone see the same things, both disagree.
    """
    # A doubtful tie contradicts nothing: a place has to be two standard errors of the tie away as well.
    return {
        number: off
        for number, off in displacements_px(ties, given).items()
        if off > max(LIMIT_SHARE * ties.tied[number].geometry.inverse_depth.shape[1], 2 * _error_px(ties, number))
    }


def _error_px(ties: Ties, number: int) -> float:
    """Return the standard error of what an exposure and its partners see, by their ties, in a picture: the largest."""
    of = [ties.tied[k] for k in (number, *ties.tied[number].partners)]
    shares = [float(np.hypot(np.radians(one.turn_error_deg), one.place_error)) for one in of]
    return max(shares) * float(of[0].geometry.intrinsics[0, 0])


def _displaced_px(pair: tuple[Tied, Tied], given: tuple[Similarity, Similarity]) -> float:
    """Return the median displacement of what the first sees in the picture of the second."""
    one, other = pair
    depth, intrinsics = depths_of(one.geometry)[0], one.geometry.intrinsics
    pixels = grid(depth.inverse_depth.shape, _EVERY_PX)
    along = depth.inverse_depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)].astype(np.float64)
    points = in_world(rays(pixels, intrinsics) / along[:, None], one.geometry.world_to_camera[depth.view])
    seen_from = other.geometry.world_to_camera[other.geometry.reference]
    places = [
        project(second.inverse.after(first).points(points), seen_from, other.geometry.intrinsics)[0]
        for first, second in ((one.common_from_own, other.common_from_own), given)
    ]
    # What comes behind a camera is as wrong as can be.
    apart = np.linalg.norm(places[0] - places[1], axis=1)
    return float(np.median(np.where(np.isfinite(apart), apart, np.inf)))


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
    agreed = ties.tied.keys() | {number for number, one in enumerate(observed) if one.repeats is not None}
    for number in elsewhere(untied, agreed, trusted):
        del trusted[number]
    known = {**_by_pictures(ties, trusted), **trusted}
    # A stage's path is better than one that a decode shows; those tied by pictures have their paths and depths anew.
    better = {number: ties.tied[number].geometry for number in known if number not in trusted}
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


def elsewhere(exposures: Sequence[Untied], agreed: Set[int], given: Mapping[int, Similarity]) -> list[int]:
    """Return given exposures that show too little of what those that agree with others show where they should see it.

    Those of which few corners should be seen by others may lie beside them, and stay.
    """
    pictures, found = _pictures(exposures), []
    for number in given.keys() - agreed:
        seen = [
            followed(pictures(number), pictures(k), given[k].inverse.after(given[number]))
            for k in agreed & given.keys()
        ]
        if sum(len(matches) for matches, _ in seen) < LEAST_SHARE * sum(visible for _, visible in seen) >= LEAST_FOUND:
            found.append(number)
    return found


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
