"""Many exposures in common coordinates, from similarities of pairs: loops closed, pairs that contradict them left out.

    the strongest tree of pairs ─► all similarities adjusted to all pairs ─► the pair that contradicts the others most
    is left out ─► until none does

Here: which exposures hang together, and their similarities. Not here: a pair (`pairs`), corners of all (`together`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gs2ci.core.arrays import F64, rms_of
from gs2ci.reconstruct.exposures.pairs import Pair
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity

# Depths of single exposures are distorted in ways that the errors of a pair do not know: its turn, movement (as a share
# of the distance) and scale are right to this at best.
_DISTORTED: Final = np.array([0.03, 0.03, 0.03, 0.03, 0.03, 0.03, 0.1])
# A pair contradicts the others if it is off by so many of its errors, in the root mean square of its seven numbers.
_CONTRADICTS: Final = 4.0
# From so many errors on, a number counts less and less.
_CAUCHY: Final = 1.5

Pairs = Mapping[tuple[int, int], Pair]


@dataclass(frozen=True, eq=False)
class Closed:
    """Exposures in common coordinates.

    Args:
        similarities: common_from_own, by index of the exposure; the identity for the first of them.
        pairs: Those that hold.
        contradicting: Those that contradict them.
    """

    similarities: dict[int, Similarity]
    pairs: tuple[tuple[int, int], ...]
    contradicting: tuple[tuple[int, int], ...]


def group_of_most(pairs: Pairs, count: int) -> list[int]:
    """Return the largest group of exposures that pairs join; of equal ones that with the earliest exposure."""
    ends = np.array(list(pairs), np.int64).reshape(-1, 2)
    joined = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(count, count))
    group = connected_components(joined, directed=False)[1]
    return np.flatnonzero(group == np.bincount(group).argmax()).tolist()


def closed(pairs: Pairs, count: int) -> Closed:
    """Bring the largest group of exposures into the coordinates of its first.

    Args:
        pairs: other_from_one by (one, other).
        count: Of exposures.
    """
    held = dict(pairs)
    contradicting: list[tuple[int, int]] = []
    while True:
        group = group_of_most(held, count)
        inside = {pair: found for pair, found in held.items() if pair[0] in group}
        similarities = _adjusted(inside, group)
        off = {pair: rms_of(_errors(found, similarities, pair)) for pair, found in inside.items()}
        worst = max(off, key=lambda pair: off[pair], default=None)
        if worst is None or off[worst] <= _CONTRADICTS:
            return Closed(similarities, tuple(inside), tuple(contradicting))
        contradicting.append(worst)
        del held[worst]


def _tree(pairs: Pairs, first: int) -> dict[int, Similarity]:
    """Go from the first exposure along the pairs with the most corners."""
    found = {first: Similarity.identity()}
    while across := [pair for pair in pairs if (pair[0] in found) != (pair[1] in found)]:
        one, other = max(across, key=lambda pair: len(pairs[pair].matches))
        between = pairs[one, other].other_from_one
        if one in found:
            found[other] = found[one].after(between.inverse)
        else:
            found[one] = found[other].after(between)
    return found


def _adjusted(pairs: Pairs, group: list[int]) -> dict[int, Similarity]:
    """Adjust the similarities of a group to its pairs."""
    start, free = _tree(pairs, group[0]), group[1:]
    if len(pairs) <= len(free):
        return start
    about = {k: _seen(k, start, pairs) for k in free}

    def moved(changes: F64) -> dict[int, Similarity]:
        rows = changes.reshape(-1, CHANGES)
        return {**start, **{k: start[k].changed(row, *about[k]) for k, row in zip(free, rows, strict=True)}}

    def errors(changes: F64) -> F64:
        now = moved(changes)
        return np.concatenate([_errors(found, now, pair) for pair, found in pairs.items()])

    return moved(least_squares(errors, np.zeros(CHANGES * len(free)), loss="cauchy", f_scale=_CAUCHY).x)


def _errors(pair: Pair, similarities: dict[int, Similarity], which: tuple[int, int]) -> F64:
    """Return by how many of its errors a pair is off, [7]."""
    between = similarities[which[1]].inverse.after(similarities[which[0]])
    change = pair.other_from_one.change_to(between, pair.centre, pair.unit)
    covariance = pair.covariance + np.diag(_DISTORTED**2)
    return np.linalg.solve(np.linalg.cholesky(covariance), change)


def _seen(number: int, similarities: dict[int, Similarity], pairs: Pairs) -> tuple[F64, float]:
    """Return the middle of what an exposure shares with others, in its coordinates, and how far away it is."""
    own = {pair: found for pair, found in pairs.items() if number in pair}
    points = [found.matches.one if pair[0] == number else found.matches.other for pair, found in own.items()]
    distances = [similarities[pair[1]].scale * found.unit for pair, found in own.items()]
    return np.median(np.concatenate(points), axis=0), float(np.median(distances))
