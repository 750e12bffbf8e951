"""The positions of a patch in the views before and after its own.

Here: dense optical flow between decoded views (OpenCV's DIS, Kroeger 2016), and positions followed along it. Not here:
the search around these positions (`matching`).
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64, U8
from gs2ci.reconstruct.threads import in_threads, one_opencv_thread

# DIS matches windows of 8 pixels on a picture halved at least once; smaller pictures are treated as standing still.
LEAST_SIDE_PX: Final = 16
# White level of the 8-bit pictures: a few saturated spots must not make the rest dark.
_WHITE_PERCENTILE: Final = 99.5
# Full scale 1: darker views show nothing that could be tracked.
_LEAST_WHITE: Final = 1e-6


@dataclass(frozen=True)
class Flow:
    """How every pixel moves between consecutive views.

    Args:
        forward: [N − 1, H, W, 2] float32: from view i to view i + 1, along columns and rows, in pixels.
        backward: [N − 1, H, W, 2]: from view i + 1 to view i.
    """

    forward: F32
    backward: F32

    @classmethod
    def between(cls, views: F32) -> "Flow":
        """Estimate it from grey views, [N, H, W]; zero if they are too small."""
        count, height, width = views.shape
        if count < 2 or min(height, width) < LEAST_SIDE_PX:
            none = np.zeros((max(count - 1, 0), height, width, 2), np.float32)
            return cls(none, none)
        seen = _as_bytes(views)
        pairs = [(i, i + 1) for i in range(count - 1)] + [(i + 1, i) for i in range(count - 1)]
        # DIS divides a picture into as many stripes as threads, which changes its result.
        with one_opencv_thread():
            flows = np.stack(in_threads(lambda pair: flow_from(seen[pair[0]], seen[pair[1]]), pairs))
        return cls(flows[: count - 1], flows[count - 1 :])

    def follow(self, places: F64, at: int, first: int, count: int) -> F64:
        """Follow positions of one view through a range of views.

        Args:
            places: Row and column in view `at`, [G, 2].
            at: That view; it lies in the range.
            first: The first view of the range.
            count: How many views it has.

        Returns:
            Row and column in each of them, [G, count, 2]; they may lie outside the picture.
        """
        followed = np.empty((len(places), count, 2))
        followed[:, at - first] = places
        for steps, flows, to in (
            (range(at, first + count - 1), self.forward, 1),
            (range(at - 1, first - 1, -1), self.backward, 0),
        ):
            now = places
            for i in steps:
                height, width = flows.shape[1:3]
                row = np.clip(np.rint(now[:, 0]).astype(np.int64), 0, height - 1)
                column = np.clip(np.rint(now[:, 1]).astype(np.int64), 0, width - 1)
                now = now + flows[i, row, column, ::-1]
                followed[:, i + to - first] = now
        return followed


def flow_from(before: U8, after: U8) -> F32:
    """Return the dense optical flow from one grey picture, [H, W], to another, [H, W, 2] px along columns and rows."""
    return cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(before, after, None)


def _as_bytes(views: F32) -> U8:
    white = max(float(np.percentile(views, _WHITE_PERCENTILE)), _LEAST_WHITE)
    return (np.clip(views / white, 0, 1) * 255).astype(np.uint8)
