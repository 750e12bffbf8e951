"""Positions of a camera that is shifted and not rotated, from its pictures of one board at rest.

Here: the adjustment of one rotation and one position per picture, for a known camera. Not here: stages (`stage`,
`axes`), the camera's own estimate (`intrinsics`).
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
"""The iteration ends at a step below this, far below the accuracy of any picture."""
RESIDUAL_MAX_PX: Final = 0.5
"""If a stage only shifts the camera, residuals are hundredths of a pixel; larger ones mean rotation, or motion."""


@dataclass(frozen=True)
class Places:
    """The positions of the camera.

    Args:
        rotation: Rotation vector of the board in the camera's frame, the same in all pictures, [3].
        board_mm: The board's origin in the camera's frame, [K, 3].
        residual_px: Rms residual at the corners, along one axis.
        covariance_mm2: Covariance of one position by that residual, as the mean over all pictures, [3, 3].
    """

    rotation: F64
    board_mm: F64
    residual_px: float
    covariance_mm2: F64

    @property
    def camera_mm(self) -> F64:
        """Get the camera's positions in its own frame, [K, 3], from an arbitrary origin: negated board positions."""
        return -self.board_mm


def find_places(sightings: Sequence[Sighting], values: F64, start: Places | None = None) -> Places:
    """Adjust one rotation and one position per picture to the corners, by Gauss-Newton.

    Args:
        sightings: The board in each picture, no corners on one line.
        values: The camera, as `CameraEstimate.values`.
        start: The start of the iteration; None begins with each picture's own pose.

    Raises:
        CalibrationError: One orientation of the board does not explain all pictures.
    """
    rotation, shifts = (start.rotation, start.board_mm) if start is not None else _first(sightings, values)
    for _ in range(PASSES):
        turn, steps, residual, covariance_mm2 = _step(sightings, values, rotation, shifts)
        # Increments of the rotation vector are added, because the derivatives are by its components.
        rotation, shifts = rotation + turn, shifts + steps
        if max(np.abs(steps).max(), np.abs(turn).max() * np.abs(shifts).max()) < CONVERGED_MM:
            break
    if not residual <= RESIDUAL_MAX_PX:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"one orientation of the board explains all {len(sightings)} pictures to {residual:.2g} px only",
            allowed=f"{RESIDUAL_MAX_PX:g} px",
            remedy="check that the board and the camera's mount are firm: this stage seems to rotate the camera",
        )
    return Places(rotation, shifts, residual, covariance_mm2)


def _first(sightings: Sequence[Sighting], values: F64) -> tuple[F64, F64]:
    """Return the first picture's orientation, and each picture's position by its own orientation."""
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
    """Return the steps of rotation [3] and positions [K, 3], the residual before them, and a position's covariance.

    The positions are eliminated picture by picture (Schur complement), which leaves three equations.
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
