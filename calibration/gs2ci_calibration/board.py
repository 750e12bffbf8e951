"""The ChArUco board: a chessboard with markers, and where its corners lie in an image.

Here: what a board is, its sighting in one image, refusals of images that show none. The detection itself is
OpenCV's. Not here: cameras and stages (`camera`, `stage`), how images are taken (`gs2ci_calibration.bench`).
`camera`, `stage` and tests import this file.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_calibration.corners import refine_corners

F64 = NDArray[np.float64]

DICTIONARIES: Final = tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and "X" in name))
CORNERS_MIN: Final = 8
"""A pose has 6 unknowns, a corner gives 2 numbers; below this many the pose hangs on single corners."""
FLATNESS_MIN: Final = 0.05
"""Corners whose second principal extent on the board is below this share of the first lie on a line: the board's turn
about that line is then free."""
PIXEL_CENTRE: Final = 0.5
"""OpenCV puts pixel centres at whole numbers, gs2ci at +0.5."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board.

    Args:
        columns: Squares along x.
        rows: Squares along y.
        square_mm: Side of a square.
        marker_mm: Side of a marker.
        dictionary: OpenCV's name of the markers ("DICT_4X4_50").
    """

    columns: int = 9
    rows: int = 7
    square_mm: float = 10.0
    marker_mm: float = 7.0
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 < self.marker_mm < self.square_mm < np.inf:
            raise InputError(
                f"board of {self.columns} x {self.rows} squares of {self.square_mm} mm, markers of {self.marker_mm} mm",
                allowed="3 x 3 squares or more, 0 < marker_mm < square_mm",
            )
        if self.dictionary not in DICTIONARIES:
            raise InputError(f"marker dictionary {self.dictionary!r}", allowed=", ".join(DICTIONARIES))

    @cached_property
    def _detector(self) -> Any:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_mm, self.marker_mm, markers)
        return cv2.aruco.CharucoDetector(board)

    def find(self, image: NDArray[Any]) -> "Sighting | None":
        """Find the board's corners in an image.

        Args:
            image: [H, W], any type of number; it is stretched to 8 bits for finding and kept for refining.

        Returns:
            What was found; None where fewer corners show than make a pose.
        """
        grey = _stretched(image)
        corners, ids, _, _ = self._detector.detectBoard(np.rint(grey).astype(np.uint8))
        if ids is None or len(ids) < CORNERS_MIN:
            return None
        found = ids.ravel().astype(int)
        on_board = self.corners_mm[found]
        rough_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2) + PIXEL_CENTRE
        corners_px, good = refine_corners(grey, rough_px, on_board[:, :2] / self.square_mm, self.gap)
        if good.sum() < CORNERS_MIN:
            return None
        return Sighting(found[good], corners_px[good], on_board[good])

    @cached_property
    def corners_mm(self) -> F64:
        """Get where the inner corners lie on the board, [K, 3], z = 0."""
        return np.asarray(self._detector.getBoard().getChessboardCorners(), dtype=np.float64).reshape(-1, 3)

    @property
    def gap(self) -> float:
        """Get how far the squares' edges are clear of markers on either side, as a share of a square."""
        return 0.5 * (1 - self.marker_mm / self.square_mm)


@dataclass(frozen=True)
class Sighting:
    """A board in one image.

    Args:
        ids: Numbers of the corners, [K].
        corners_px: Where they were found, [K, 2] x and y, pixel centres at +0.5.
        corners_mm: Where they lie on the board, [K, 3], z = 0.
    """

    ids: NDArray[np.int_]
    corners_px: F64
    corners_mm: F64

    @property
    def collinear(self) -> bool:
        """Get whether the corners lie on one line of the board, or nearly."""
        centred = self.corners_mm[:, :2] - self.corners_mm[:, :2].mean(axis=0)
        extents = np.linalg.svd(centred, compute_uv=False)
        return bool(extents[1] < FLATNESS_MIN * extents[0])


def median_square_px(sightings: Sequence[Sighting], board: Board) -> float:
    """Return the typical side of a square in the images, in pixels."""
    sides = [
        np.sqrt(np.prod(np.ptp(s.corners_px, axis=0)) / max(np.prod(np.ptp(s.corners_mm[:, :2], axis=0)), 1e-12))
        for s in sightings
    ]
    return float(np.median(sides) * board.square_mm)


def _stretched(image: NDArray[Any]) -> NDArray[np.float32]:
    """Stretch the image's range to 0 to 255, as float32; an even image becomes 0."""
    low, high = np.percentile(image, (0.5, 99.5))
    scale = 255.0 / (high - low) if high > low else 0.0
    return np.asarray(np.clip((image.astype(np.float64) - low) * scale, 0, 255), dtype=np.float32)
