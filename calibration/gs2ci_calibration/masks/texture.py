"""Patterns with edges everywhere, for registration: random checkers."""

import numpy as np

from gs2ci.core.arrays import U8, Rng


def checker(size: tuple[int, int], cell: int, rng: Rng, *, start: tuple[int, int] = (0, 0)) -> U8:
    """Return a checker pattern whose squares are black or white at random, [Hm, Wm] uint8: edges everywhere.

    Args:
        size: The modulator's height and width.
        cell: Side of a square in modulator pixels; two to four sensor pixels are best.
        rng: Random generator.
        start: Row and column on which a square begins.
    """
    rows, columns = ((np.arange(side) - first) // cell for side, first in zip(size, start, strict=True))
    squares = rng.random((int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1)) < 0.5
    return squares[np.ix_(rows - rows.min(), columns - columns.min())].astype(np.uint8)
