"""The order of depth of single exposures, where their tracks leave it open: the one that others confirm.

A small motion often allows near and far to be exchanged (`geometry.reversal`). Other exposures see the same things from
farther away: in the wrong order a picture is not warped onto theirs, and fewer corners are followed. Of eight exposures
in a row, the one whose order was wrong had 440 corners in common with its neighbours and 650 in the other order; the
seven right ones lost 20 to 60 % by exchanging it.

Here: which exposures are turned. Not here: pairs (`pairs`), the order within one exposure
(`hypotheses.order`).
"""

from collections.abc import Mapping
from typing import Final

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.exposures.pairs import Pair, tie_pair
from gs2ci.reconstruct.exposures.pictures import MeanPicture, pictures_of
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import turned
from gs2ci.reconstruct.hypotheses.order import is_open
from gs2ci.reconstruct.threads import in_threads

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
