"""Ranks and rank correlation: `scipy.stats` has them too, but importing it takes longer than writing a report.

Not here: any decision by them.
"""

import numpy as np
from numpy.typing import ArrayLike

from gs2ci.core.arrays import F64


def ranks(values: ArrayLike) -> F64:
    """Return the ranks of numbers, [N], from 1; equal numbers get their mean rank."""
    _, which, counts = np.unique(np.asarray(values).reshape(-1), return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts - 1) / 2)[which]


def rank_correlation(one: ArrayLike, other: ArrayLike) -> float:
    """Return Spearman's rank correlation of numbers, [N] each; NaN if all numbers of either are equal."""
    apart = [own - own.mean() for own in (ranks(one), ranks(other))]
    lengths = [float(np.sqrt(own @ own)) for own in apart]
    if min(lengths) == 0:
        return float("nan")
    return float(np.clip(apart[0] @ apart[1] / (lengths[0] * lengths[1]), -1, 1))
