"""The ChArUco board: a chessboard with markers, and the positions of its corners in an image.

Here: a board and its corners in one image. The detection is OpenCV's, the refinement to hundredths of a pixel is ours
(`corners`). Not here: cameras and stages (`intrinsics`, `axes`), taking pictures (`pictures`).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci_calibration.geometry.corners import refine_corners
from gs2ci_calibration.options import BoardSpec

DICTIONARIES: Final = tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and "X" in name))
CORNERS_MIN: Final = 6
"""A pose has 6 unknowns, a corner gives 2 numbers; with fewer corners a pose depends on single ones."""
DETECTION_PX: Final = 480
"""Images with a shorter side are enlarged for detection: OpenCV's search for markers needs some pixels per bit."""
FEW_SHARE: Final = 0.6
"""Share of all corners: with fewer, another enlargement is tried as well."""
FLATNESS_MIN: Final = 0.05
"""Corners whose second principal extent on the board is below this share of the first lie on a line: the board's
rotation about that line is then undetermined."""
PIXEL_CENTRE: Final = 0.5
"""OpenCV has pixel centres at integers, gs2ci at +0.5."""


@dataclass(frozen=True)
class Board:
    """A ChArUco board that can be found in images.

    Args:
        spec: Its description.

    Raises:
        InputError: There is no such board.
    """

    spec: BoardSpec = field(default_factory=BoardSpec)

    def __post_init__(self) -> None:
        spec = self.spec
        if min(spec.columns, spec.rows) < 3 or not 0 < spec.marker_mm < spec.square_mm < np.inf:
            raise InputError(
                f"board of {spec.columns} x {spec.rows} squares of {spec.square_mm} mm, markers of {spec.marker_mm} mm",
                allowed="3 x 3 squares or more, 0 < marker_mm < square_mm",
                remedy="correct [calibration.board]",
            )
        if spec.dictionary not in DICTIONARIES:
            raise InputError(
                f"marker dictionary {spec.dictionary!r}",
                allowed=", ".join(DICTIONARIES),
                remedy="correct [calibration.board]",
            )

    @cached_property
    def _detector(self) -> Any:
        spec = self.spec
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec.dictionary))
        needed = spec.columns * spec.rows // 2
        if needed > len(markers.bytesList):
            raise InputError(
                f"a board of {spec.columns} x {spec.rows} squares needs {needed} markers, {spec.dictionary} has "
                f"{len(markers.bytesList)}",
                remedy="choose a larger dictionary in [calibration.board]",
            )
        board = cv2.aruco.CharucoBoard((spec.columns, spec.rows), spec.square_mm, spec.marker_mm, markers)
        return cv2.aruco.CharucoDetector(board)

    def find(self, image: NDArray[Any]) -> "Sighting | None":
        """Find the board's corners in an image.

        Args:
            image: [H, W], any type of number; it is stretched to 8 bits for the search and used as it is for refining.

        Returns:
            The corners found; None if there are too few for a pose.
        """
        grey = _stretched(image)
        found, rough_px = self._detected(grey)
        if len(found) < CORNERS_MIN:
            return None
        on_board = self.corners_mm[found]
        rough = Sighting(found, rough_px, on_board)
        if rough.collinear:
            return rough  # too few pixels to refine it: the caller refuses it, or takes another picture
        corners_px, blur_px = refine_corners(grey, rough_px, on_board[:, :2] / self.spec.square_mm, self.gap)
        good = np.isfinite(blur_px)
        if good.sum() < CORNERS_MIN:
            return None
        return Sighting(found[good], corners_px[good], on_board[good], float(np.median(blur_px[good])))

    def _detected(self, grey: F32) -> tuple[NDArray[np.int_], F64]:
        """Return the corners' numbers [K] and rough places [K, 2], at the enlargement that finds most of them."""
        smallest = max(1, int(np.ceil(DETECTION_PX / min(grey.shape))))
        best: tuple[NDArray[np.int_], F64] = (np.zeros(0, int), np.zeros((0, 2)))
        # Small markers may be missed at one enlargement and found at the next.
        for factor in (smallest, smallest + 1, smallest + 2):
            large = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC) if factor > 1 else grey
            corners, ids, _, _ = self._detector.detectBoard(np.clip(np.rint(large), 0, 255).astype(np.uint8))
            if ids is not None and len(ids) > len(best[0]):
                at = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + PIXEL_CENTRE) / factor
                best = ids.ravel().astype(int), at
            if len(best[0]) > FEW_SHARE * len(self.corners_mm):
                break
        return best

    @cached_property
    def corners_mm(self) -> F64:
        """Get the positions of the inner corners on the board, [K, 3], z = 0."""
        return np.asarray(self._detector.getBoard().getChessboardCorners(), dtype=np.float64).reshape(-1, 3)

    @property
    def gap(self) -> float:
        """Get the distance between the squares' edges and the markers, as a share of a square."""
        return 0.5 * (1 - self.spec.marker_mm / self.spec.square_mm)


@dataclass(frozen=True)
class Sighting:
    """A board in one image.

    Args:
        ids: Numbers of the corners, [K].
        corners_px: Their positions in the image, [K, 2] x and y, pixel centres at +0.5.
        corners_mm: Their positions on the board, [K, 3], z = 0.
        blur_px: Median standard deviation of the blur of their edges, without the pixels' own.
    """

    ids: NDArray[np.int_]
    corners_px: F64
    corners_mm: F64
    blur_px: float = 0.0

    @property
    def collinear(self) -> bool:
        """Get whether the corners lie on one line of the board, or nearly."""
        centred = self.corners_mm[:, :2] - self.corners_mm[:, :2].mean(axis=0)
        extents = np.linalg.svd(centred, compute_uv=False)
        return bool(extents[1] < FLATNESS_MIN * extents[0])


def _stretched(image: NDArray[Any]) -> F32:
    """Stretch the image's range to 0 to 255, as float32; a constant image becomes 0."""
    low, high = np.percentile(image, (0.5, 99.5))
    scale = 255.0 / (high - low) if high > low else 0.0
    return np.asarray(np.clip((image.astype(np.float64) - low) * scale, 0, 255), dtype=np.float32)
