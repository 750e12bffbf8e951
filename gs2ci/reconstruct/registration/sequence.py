"""Which mask was shown first, told by how views follow each other.

A camera that moves on sees views that differ the more, the further apart in time they are. Where a list of masks begins
with the wrong one, the last views come first and that no longer holds; it holds again for one other beginning. So the
rank correlation between the distance of two decoded views and their distance in time is compared for all beginnings.
It stays the same if the sequence is reversed: which end came first is not to be told. Nor is any other order sought,
since a camera that trembles or goes to and fro passes the same places out of order. Where it does, no beginning ranks
well, and nothing is concluded.
Here: the beginning, and how sure it is. Not here: what is corrected by it (`register`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.ranks import ranks

# Fewer views have too few distances to be ranked.
LEAST_VIEWS: Final = 4
# Right orders of moving cameras reach 0.7 to 0.97 in decoded views, their rotations at most 0.55; without motion or in
# much noise any is about 0 to 0.5.
_FOLLOWS: Final = 0.75
_LEAST_GAIN: Final = 0.25


@dataclass(frozen=True)
class Beginning:
    """Which of the masks was the first.

    Args:
        first: Its number in the list, from 0.
        rank: Rank correlation of the views' distances with their distances in time, beginning there.
        rank_as_given: That of the order as given.
    """

    first: int
    rank: float
    rank_as_given: float

    @property
    def is_other(self) -> bool:
        """Get whether the list surely begins elsewhere than it says."""
        return self.first != 0 and self.rank >= _FOLLOWS and self.rank - self.rank_as_given >= _LEAST_GAIN


def find_beginning(views: F32) -> Beginning | None:
    """Find the view that came first.

    Args:
        views: Decoded without any coupling between consecutive ones, [N, H, W, C].

    Returns:
        The beginning with the highest rank correlation; None of fewer than `LEAST_VIEWS` views, or where all are
        alike or one is not finite.
    """
    count = len(views)
    if count < LEAST_VIEWS or not np.isfinite(views).all():
        return None
    distances = _squared_distances(views)
    one, other = np.triu_indices(count, 1)
    if np.ptp(distances[one, other]) == 0:
        return None
    apart = ranks(other - one)
    found = []
    for first in range(count):
        order = (np.arange(count) + first) % count
        found.append(float(np.corrcoef(ranks(distances[order[one], order[other]]), apart)[0, 1]))
    best = int(np.argmax(found))
    return Beginning(best, found[best], found[0])


def _squared_distances(views: F32) -> F64:
    """Return the squared distance of every view from every other, [N, N], their mean levels apart."""
    flat = views.reshape(len(views), -1).astype(np.float64)
    flat -= flat.mean(axis=1, keepdims=True)
    products = flat @ flat.T
    own = np.diag(products)
    distances: F64 = own[:, None] + own[None, :] - 2 * products
    return distances
