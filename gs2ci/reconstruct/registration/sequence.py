"""Which mask was displayed first, estimated from the order of the decoded views.

Views of a camera that moves on differ more, the further apart in time they are. If a list of masks starts with the
wrong one, the last views come first and this no longer holds; it holds for the right start. So the rank correlation
between the distance of two decoded views and their distance in time is compared for all starts. It is the same for a
reversed sequence, so the direction of time is not determined. No other order is tried, since a camera that trembles or
moves to and fro passes the same positions out of order. In that case no start has a high rank correlation, and nothing
is concluded. Nor is it from a path that returns to where it began, of which every start is as good: between the two
views that would be the last and the first, a path that does not return has a jump.

Here: the start, and how sure it is. Not here: the correction (`register`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.distance import pdist, squareform

from gs2ci.core.arrays import F32
from gs2ci.core.ranks import ranks

# Four views have six distances: of unrelated ones the best start follows in one case of six, and no threshold helps.
LEAST_VIEWS: Final = 5
# The right order of a moving camera's decoded views has 0.7 to 0.97, wrong starts at most 0.55; without motion or with
# much noise any start of eight views or more has about 0 to 0.5.
_FOLLOWS: Final = 0.75
# Fewer views have few distances: the thresholds that the best start of unrelated views passes once in a thousand.
_FOLLOWS_OF_FEW: Final = {5: 0.94, 6: 0.86, 7: 0.78}
_LEAST_GAIN: Final = 0.25


@dataclass(frozen=True)
class Beginning:
    """The mask that was displayed first.

    Args:
        first: Its index in the list, from 0.
        views: Of how many views.
        rank: Rank correlation of the views' distances with their distances in time, for this start.
        rank_as_given: The same for the given order.
    """

    first: int
    views: int
    rank: float
    rank_as_given: float

    @property
    def is_other(self) -> bool:
        """Get whether the list surely starts with another mask than stated."""
        follows = self.rank >= _FOLLOWS_OF_FEW.get(self.views, _FOLLOWS)
        return self.first != 0 and follows and self.rank - self.rank_as_given >= _LEAST_GAIN


def find_beginning(views: F32) -> Beginning | None:
    """Find the view that came first.

    Args:
        views: Decoded without any coupling between consecutive ones, [N, H, W, C].

    Returns:
        The start with the highest rank correlation, or the given one if there is no jump at the other; None for fewer
        than `LEAST_VIEWS` views, or if all are alike or one is not finite.
    """
    count = len(views)
    if count < LEAST_VIEWS or not np.isfinite(views).all():
        return None
    flat = views.reshape(count, -1).astype(np.float64)
    distances = squareform(pdist(flat - flat.mean(axis=1, keepdims=True), "sqeuclidean"))
    one, other = np.triu_indices(count, 1)
    if np.ptp(distances[one, other]) == 0:
        return None
    apart = ranks(other - one)
    found = []
    for first in range(count):
        order = (np.arange(count) + first) % count
        found.append(float(np.corrcoef(ranks(distances[order[one], order[other]]), apart)[0, 1]))
    best = int(np.argmax(found))
    consecutive = np.median(distances[np.arange(count - 1), np.arange(1, count)])
    if distances[best - 1, best] <= (consecutive + np.median(distances[one, other])) / 2:
        best = 0
    return Beginning(best, count, found[best], found[0])
