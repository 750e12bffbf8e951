"""Where a camera that is shifted and never turned stood, from its pictures of one board at rest.

Here: the adjustment of one rotation and a place per picture, the camera's figures given. Not here: stages (`stage`,
the only user beside tests), the camera's own estimate (`intrinsics`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_calibration.geometry.board import PIXEL_CENTRE, Sighting
from gs2ci_calibration.geometry.intrinsics import project
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "stage"

PASSES: Final = 20
CONVERGED_MM: Final = 1e-9
"""A step that moves nothing by more ends the iteration: far below what any picture shows."""
RESIDUAL_MAX_PX: Final = 0.5
"""A stage that only shifts the camera leaves hundredths of a pixel; more is a stage that turns it, or motion."""


@dataclass(frozen=True)
class Places:
    """Where the camera stood.

    Args:
        rotation: Rotation vector of the board in the camera's frame, the same in all pictures, [3].
        board_mm: The board's origin in the camera's frame, [K, 3].
        residual_px: Root mean square of what is left at the corners, along one axis.
        covariance_mm2: What that makes of one place, as the mean over all pictures, [3, 3].
    """

    rotation: F64
    board_mm: F64
    residual_px: float
    covariance_mm2: F64

    @property
    def camera_mm(self) -> F64:
        """Get the camera's places in its own frame, from any beginning, [K, 3]: the board moves the other way."""
        return -self.board_mm


def find_places(sightings: Sequence[Sighting], values: F64, start: Places | None = None) -> Places:
    """Adjust one rotation and one place per picture to the corners, by Gauss and Newton.

    Args:
        sightings: What each picture shows of the board; none on a line.
        values: The camera, as of `CameraEstimate.values`.
        start: Where to begin; None begins with each picture's own pose.

    Raises:
        CalibrationError: One orientation of the board does not explain all pictures.
    """
    rotation, shifts = (start.rotation, start.board_mm) if start is not None else _first(sightings, values)
    for _ in range(PASSES):
        turn, steps, residual, covariance_mm2 = _step(sightings, values, rotation, shifts)
        # A rotation vector's own increments: the derivatives are by its components.
        rotation, shifts = rotation + turn, shifts + steps
        if max(np.abs(steps).max(), np.abs(turn).max() * np.abs(shifts).max()) < CONVERGED_MM:
            break
    if not residual <= RESIDUAL_MAX_PX:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"one orientation of the board explains all {len(sightings)} pictures to {residual:.2g} px only",
            allowed=f"{RESIDUAL_MAX_PX:g} px",
            remedy="see that the board and the camera's mount are firm: this stage seems to turn the camera",
        )
    return Places(rotation, shifts, residual, covariance_mm2)


def _first(sightings: Sequence[Sighting], values: F64) -> tuple[F64, F64]:
    """Return the first picture's orientation, and each picture's place under its own."""
    matrix = np.array([[values[0], 0, values[2] - PIXEL_CENTRE], [0, values[1], values[3] - PIXEL_CENTRE], [0, 0, 1.0]])
    poses = []
    for sighting in sightings:
        found, rotation, shift = cv2.solvePnP(
            sighting.corners_mm, sighting.corners_px - PIXEL_CENTRE, matrix, values[4:8], flags=cv2.SOLVEPNP_IPPE
        )
        if not found or not np.isfinite(shift).all():
            raise CalibrationError(
                STEP,
                Reason.DEGENERATE_VIEWS,
                "a picture of the board gives no pose",
                remedy="show more of the board, closer to the camera",
            )
        poses.append((rotation.ravel(), shift.ravel()))
    return poses[0][0], np.stack([shift for _, shift in poses])


def _step(sightings: Sequence[Sighting], values: F64, rotation: F64, shifts: F64) -> tuple[F64, F64, float, F64]:
    """Return the steps of rotation [3] and places [K, 3], the residual before them, and the covariance of a place.

    The places are eliminated picture by picture (Schur's complement), which leaves three equations.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    kept = []
    squares, count, spread = 0.0, 0, np.zeros((3, 3))
    for sighting, shift in zip(sightings, shifts, strict=True):
        at, _, by_pose = project(values, sighting.corners_mm, rotation, shift)
        left = (sighting.corners_px - at).ravel()
        turn, move = by_pose[:, :3], by_pose[:, 3:]
        inverse = np.linalg.inv(move.T @ move)
        eliminated = inverse @ (move.T @ turn)
        normal += turn.T @ turn - (turn.T @ move) @ eliminated
        right += turn.T @ left - eliminated.T @ (move.T @ left)
        kept.append((eliminated, inverse @ (move.T @ left)))
        squares, count, spread = squares + float(left @ left), count + len(left), spread + inverse
    step = np.linalg.solve(normal, right)
    moves = np.stack([alone - eliminated @ step for eliminated, alone in kept])
    residual = float(np.sqrt(squares / max(count - 3 - 3 * len(sightings), 1)))
    return np.asarray(step, dtype=np.float64), moves, residual, residual**2 * spread / len(sightings)
