"""Scale-invariant features of decoded views, and which of two views' are alike.

Here: SIFT (Lowe 2004), in tilted pictures as well (ASIFT, Morel and Yu 2009), and mutual matches. Not here: any camera
(`wide`, `mapper`: of the views of one exposure; `gs2ci.reconstruct.exposures`: of several exposures).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, U32

# Decoded views are blurred: features are detected at twice their size, with equalised local contrast.
_ENLARGED: Final = 2
_MOST_FEATURES: Final = 2000
_LEAST_CONTRAST: Final = 0.01
# Pictures are tilted so many times, each by √2 more (OpenCV's `maxTilt`).
_STEEPEST: Final = 2
# A match must be mutual, and nearer than this share of the distance to the second nearest feature (Lowe's test).
_RATIO: Final = 0.8
# Features are compared with those of another view so many at a time: of two views in tilted pictures, all at once would
# take 4 GB.
_ROWS: Final = 2048


def find_features(view: F32, tilted: int | None = None) -> tuple[F32, F32]:
    """Find features of a view: positions, [F, 2] px, and RootSIFT descriptors, [F, 128].

    Args:
        view: [H, W, C].
        tilted: At most so many, the strongest, of tilted pictures, too; None: of the view as it is.
    """
    grey = (view.mean(axis=2).clip(0, 1) * 255).astype(np.uint8)
    large = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    even = cv2.createCLAHE(2.0, (8, 8)).apply(large)
    sift = cv2.SIFT_create(nfeatures=_MOST_FEATURES, contrastThreshold=_LEAST_CONTRAST)  # type: ignore[attr-defined]
    finder = sift if tilted is None else cv2.AffineFeature_create(sift, _STEEPEST)  # type: ignore[attr-defined]
    points, found = finder.detectAndCompute(even, None)
    if found is None:
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32)
    if tilted is not None and len(points) > tilted:
        strongest = np.argsort([-point.response for point in points], kind="stable")[:tilted]
        points, found = [points[k] for k in strongest], found[strongest]
    places = np.array([point.pt for point in points], np.float32)
    # OpenCV has the first pixel's centre at 0, this project at 0.5.
    places = ((places + 0.5) / _ENLARGED).astype(np.float32)
    shares = found / np.maximum(found.sum(axis=1, keepdims=True), 1)
    return places, np.sqrt(shares).astype(np.float32)


def match_features(one: F32, other: F32) -> U32:
    """Match descriptors, [F, 128] and [G, 128]: indices, [M, 2]."""
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2), np.uint32)
    # Descriptors have length 1: the nearest has the largest product.
    nearest = np.empty(len(one), np.int64)
    best, second = np.empty((2, len(one)), np.float32)
    of_other = np.full(len(other), -np.inf, np.float32)
    for first in range(0, len(one), _ROWS):
        rows = slice(first, first + _ROWS)
        likeness = one[rows] @ other.T
        here = np.arange(len(likeness))
        nearest[rows] = at = likeness.argmax(axis=1)
        best[rows] = likeness[here, at]
        # The largest of a column, not where it is: that takes NumPy 20 times as long.
        np.maximum(of_other, likeness.max(axis=0), out=of_other)
        likeness[here, at] = -1
        second[rows] = likeness.max(axis=1)
    distance, to_second = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (best, second))
    kept = np.flatnonzero((best == of_other[nearest]) & (distance < _RATIO * to_second))
    # Of features that are exactly alike, the first.
    _, firsts = np.unique(nearest[kept], return_index=True)
    kept = kept[np.sort(firsts)]
    return np.stack([kept, nearest[kept]], axis=1).astype(np.uint32)
