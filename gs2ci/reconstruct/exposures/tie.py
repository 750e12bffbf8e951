"""Exposures without telemetry brought into common coordinates, by what several of them see.

    each exposure's pictures ─► similarities of pairs ─► orders of depth ─► loops closed ─► pairs that were missed,
    found again where loops say they lie ─► paths and depths, from corners that several exposures see

Each exposure alone has coordinates and a unit of its own, and a depth that a small motion distorts. Here: the order of
these steps, and what is left out and why. Not here: the steps (`pictures`, `pairs`, `loops`, `refined`),
exposures whose path a stage reported (`observing`), files.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.exposures.loops import Closed, closed
from gs2ci.reconstruct.exposures.pairs import Pair, tie_pair
from gs2ci.reconstruct.exposures.pictures import MeanPicture, pictures_of
from gs2ci.reconstruct.exposures.refined import Refined, refined
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import turned
from gs2ci.reconstruct.geometry.tracks.features import match_features
from gs2ci.reconstruct.hypotheses.order import is_open
from gs2ci.reconstruct.threads import in_threads

# The order of depth of single exposures, where their tracks leave it open: the one that others confirm.
#
# A small motion often allows near and far to be exchanged (`geometry.reversal`). Other exposures see the same things
# from farther away: in the wrong order a picture is not warped onto theirs, and fewer corners are followed. Of eight
# exposures in a row, the one whose order was wrong had 440 corners in common with its neighbours and 650 in the other
# order; the seven right ones lost 20 to 60 % by exchanging it.

# The other order is taken if it has at least so many times the corners in common with other exposures.
_BETTER: Final = 1.1

Pictures = tuple[MeanPicture, ...]
Pairs = dict[tuple[int, int], Pair]


def turn_the_wrong(
    views: Mapping[int, F32],
    geometries: dict[int, Geometry],
    pictures: dict[int, Pictures],
    pairs: Pairs,
) -> set[int]:
    """Exchange near and far of exposures that have more in common with the others so; what is given is replaced.

    Args:
        views: Of each exposure, by index.
        geometries: Likewise.
        pictures: Likewise.
        pairs: Of all exposures that anything ties.

    Returns:
        Those that were turned.
    """
    others = {k: turned(one) for k, one in geometries.items() if is_open(one, Criteria())}
    other_pictures = {k: pictures_of(views[k], one) for k, one in others.items()}
    tried = {k: _with(k, other_pictures[k], pictures, pairs) for k in others}
    found: set[int] = set()
    while tried:
        best = max(tried, key=lambda k: _common(tried[k]) - _BETTER * _common(_of(k, pairs)))
        if _common(tried[best]) <= _BETTER * _common(_of(best, pairs)):
            break
        found.add(best)
        for pair in _of(best, pairs):
            del pairs[pair]
        pairs |= tried.pop(best)
        geometries[best], pictures[best] = others[best], other_pictures[best]
        # What its neighbours have in common with it has changed.
        near = {k for pair in _of(best, pairs) for k in pair} & set(tried)
        tried |= {k: _with(k, other_pictures[k], pictures, pairs) for k in near}
    return found


def _with(number: int, pictures: Pictures, others: Mapping[int, Pictures], pairs: Pairs) -> Pairs:
    """Tie an exposure with other pictures to those that it is tied to."""

    def again(pair: tuple[int, int]) -> Pair | None:
        one, other = (pictures if k == number else others[k] for k in pair)
        return tie_pair(one, other)

    own = list(_of(number, pairs))
    return {pair: one for pair, one in zip(own, in_threads(again, own), strict=True) if one is not None}


def _of(number: int, pairs: Pairs) -> Pairs:
    return {pair: one for pair, one in pairs.items() if number in pair}


def _common(pairs: Pairs) -> int:
    return sum(len(one.matches) for one in pairs.values())


# Fewer features than this are no texture: RANSAC needs seven that agree.
_LEAST_FEATURES: Final = 10
# Up to so many exposures all pairs are matched. Of more, each with so many others, those with the most matches among
# so many of its strongest features.
_ALL_PAIRS: Final = 12
_PARTNERS: Final = 8
_STRONGEST: Final = 256


class Why(StrEnum):
    """Why an exposure is not tied."""

    NOT_FINITE = "its views, path or depth hold numbers that are not finite"
    NO_TEXTURE = "its views show too few features"
    NOTHING_SHARED = "nothing that it shows is seen in another exposure"
    CONTRADICTED = "what ties it to one exposure contradicts what ties the others"
    APART = "it is tied only to exposures that the others do not see"


@dataclass(frozen=True, eq=False)
class Untied:
    """An exposure before it is tied.

    Args:
        name: For reports.
        views: Decoded or fitted, [N, H, W, C] float32 in full scales; of a lens that distorts, straightened.
        geometry: Its path and depth in its own coordinates. One without a path may be tied as well; its path is found.
    """

    name: str
    views: F32
    geometry: Geometry


@dataclass(frozen=True, eq=False)
class Tied:
    """An exposure in common coordinates.

    Args:
        name: Its name.
        common_from_own: The similarity from its own coordinates.
        geometry: Its path and depth in its own coordinates, as corners that other exposures see give them; the pose of
            its reference view is unchanged.
        turn_error_deg: Standard error of the similarity's rotation.
        place_error: Of the place of what it sees, as a share of its distance from the camera.
        partners: Indices of exposures that see the same things.
        corners: How many of its corners others see.
        turned: Whether the order of its depths was exchanged, because it has more in common with the others so.
    """

    name: str
    common_from_own: Similarity
    geometry: Geometry
    turn_error_deg: float
    place_error: float
    partners: tuple[int, ...]
    corners: int
    turned: bool = False


@dataclass(frozen=True, eq=False)
class NotTied:
    """An exposure that nothing ties, and why."""

    name: str
    why: Why


@dataclass(frozen=True, eq=False)
class Ties:
    """What became of each exposure.

    Args:
        all: In the order given. The first `Tied` one's coordinates are common to all.
        distance_px: Median distance of corners from where other exposures should see them; None if there is none.
    """

    all: tuple[Tied | NotTied, ...]
    distance_px: float | None

    @property
    def tied(self) -> dict[int, Tied]:
        """Get the tied ones by index."""
        return {number: one for number, one in enumerate(self.all) if isinstance(one, Tied)}

    @property
    def left_out(self) -> dict[int, NotTied]:
        """Get the others by index."""
        return {number: one for number, one in enumerate(self.all) if isinstance(one, NotTied)}


def tie(exposures: Sequence[Untied]) -> Ties:
    """Bring exposures of one scene into common coordinates, in any order; leave out what nothing ties.

    Args:
        exposures: Any number; each with any number of views. A single one is tied to itself.

    Returns:
        For each the similarity, or why it is left out. Of several groups that nothing joins, the largest; of equal
        ones, that with the first exposure.
    """
    if not exposures:
        return Ties((), None)
    if len(exposures) == 1 and _finite(exposures[0]):
        only = exposures[0]
        return Ties((Tied(only.name, Similarity.identity(), only.geometry, 0.0, 0.0, (), 0),), None)
    finite = [number for number, one in enumerate(exposures) if _finite(one)]
    made = in_threads(lambda number: pictures_of(exposures[number].views, exposures[number].geometry), finite)
    pictures = dict(zip(finite, made, strict=True))
    textured = [number for number in finite if max(len(one.places) for one in pictures[number]) >= _LEAST_FEATURES]
    tried = _likely(pictures, textured)
    found = in_threads(lambda pair: tie_pair(pictures[pair[0]], pictures[pair[1]]), tried)
    pairs = {pair: one for pair, one in zip(tried, found, strict=True) if one is not None}
    geometries = {number: exposures[number].geometry for number in finite}
    turned = turn_the_wrong({number: exposures[number].views for number in finite}, geometries, pictures, pairs)
    frame = closed(pairs, len(exposures))
    pairs |= _found_again(pictures, frame, pairs)
    frame = closed(pairs, len(exposures))
    if len(frame.similarities) < 2:
        return Ties(tuple(_left_out(one, k, finite, textured, pairs, frame) for k, one in enumerate(exposures)), None)
    known = {number: geometries[number] for number in frame.similarities}
    views = {number: exposures[number].views for number in known}
    better = refined(views, known, frame.similarities, frame.pairs)
    every = (
        _tied(one.name, k, better, frame, turned=k in turned)
        if k in known
        else _left_out(one, k, finite, textured, pairs, frame)
        for k, one in enumerate(exposures)
    )
    return Ties(tuple(every), better.distance_px)


def _finite(one: Untied) -> bool:
    geometry = one.geometry
    depths = [geometry.inverse_depth, *(depth.inverse_depth for depth in geometry.view_depths)]
    parts: list[NDArray[Any]] = [one.views, geometry.world_to_camera, geometry.intrinsics, *depths]
    return all(np.isfinite(part).all() for part in parts) and all((depth > 0).all() for depth in depths)


def _likely(pictures: dict[int, Pictures], textured: Sequence[int]) -> list[tuple[int, int]]:
    """Choose the pairs that are matched."""
    every = list(itertools.combinations(textured, 2))
    if len(textured) <= _ALL_PAIRS:
        return every
    strongest = {k: _strongest(pictures[k][0]) for k in textured}
    counts = in_threads(lambda pair: len(match_features(strongest[pair[0]], strongest[pair[1]])), every)
    chosen = set()
    for number in textured:
        own = [(-count, pair) for pair, count in zip(every, counts, strict=True) if number in pair]
        chosen |= {pair for _, pair in sorted(own)[:_PARTNERS]}
    return sorted(chosen)


def _strongest(picture: MeanPicture) -> F32:
    """Return the descriptors of features spread over a picture: OpenCV lists them by their place in scale."""
    step = max(1, len(picture.descriptors) // _STRONGEST)
    return picture.descriptors[::step][:_STRONGEST]


def _found_again(pictures: dict[int, Pictures], frame: Closed, pairs: Pairs) -> Pairs:
    """Return pairs of tied exposures that features did not tie, but that see the same things where loops say."""
    missed = [
        pair
        for pair in itertools.combinations(sorted(frame.similarities), 2)
        if pair not in pairs and pair not in frame.contradicting
    ]

    def again(pair: tuple[int, int]) -> Pair | None:
        one, other = pair
        guess = frame.similarities[other].inverse.after(frame.similarities[one])
        return tie_pair(pictures[one], pictures[other], guess)

    return {pair: one for pair, one in zip(missed, in_threads(again, missed), strict=True) if one is not None}


def _tied(name: str, number: int, better: Refined, frame: Closed, *, turned: bool) -> Tied:
    turn, place = better.errors[number]
    partners = sorted({k for pair in frame.pairs if number in pair for k in pair} - {number})
    return Tied(
        name,
        better.similarities[number],
        better.geometries[number],
        float(np.degrees(turn)),
        float(place),
        tuple(partners),
        better.corners[number],
        turned,
    )


def _left_out(
    one: Untied,
    number: int,
    finite: Sequence[int],
    textured: Sequence[int],
    pairs: Pairs,
    frame: Closed,
) -> NotTied:
    if number not in finite:
        return NotTied(one.name, Why.NOT_FINITE)
    if number not in textured:
        return NotTied(one.name, Why.NO_TEXTURE)
    own = [pair for pair in pairs if number in pair]
    if not own:
        return NotTied(one.name, Why.NOTHING_SHARED)
    return NotTied(one.name, Why.CONTRADICTED if set(own) <= set(frame.contradicting) else Why.APART)
