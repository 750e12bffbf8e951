"""The camera's intrinsics and distortion from pictures of a ChArUco board in several poses, with standard errors.

Here: the estimate and its refusals. The minimisation is OpenCV's; the standard errors are ours, from the residuals'
Jacobian at the minimum. Not here: finding corners (`board`), taking the pictures (`pictures`), the bundle. The step
`stage` uses this estimate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.stats import t as student

from gs2ci.core.arrays import F64
from gs2ci_calibration.geometry.board import PIXEL_CENTRE, Sighting
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "camera"

PARAMETERS: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
POSES_MIN: Final = 6
"""Each picture gives at most two constraints on four intrinsics (Zhang 2000, section 2.3) besides distortion; with
more than twice as many as needed, one bad picture can be recognised."""
TILT_SPREAD_MIN_DEG: Final = 15.0
"""Smallest allowed value of the largest angle between two of the board's normals: parallel planes leave the focal
length undetermined (Zhang 2000, section 4)."""
RESIDUAL_MAX_PX: Final = 0.5
"""Good pictures have residuals of some hundredths of a pixel; half a pixel means a bent or wrong board, or motion."""
PICTURE_RESIDUAL_FACTOR: Final = 5.0
"""A picture whose residual exceeds the median by this factor does not show a flat board at rest."""
FOCAL_ERROR_MAX: Final = 0.002
"""Largest accepted relative standard error of the focal length: the scale of the stage needs this accuracy."""
COVERAGE_MIN: Final = 0.3
"""Smallest share of the frame's width and of its height that the corners of all pictures together must span."""


@dataclass(frozen=True)
class CameraEstimate:
    """The estimate of a camera.

    Args:
        size: Height and width of its image.
        values: fx, fy, cx, cy in pixels (pixel centres at +0.5), k1, k2, p1, p2 of Brown's model as in OpenCV, [8].
        covariance: Covariance of `values`, [8, 8].
        residual_px: Rms distance between corners and model, along one axis.
        residuals_px: The same for each picture, [V].
        corners: How many corners were used.
        tilt_spread_deg: Largest angle between two of the board's normals.
    """

    size: tuple[int, int]
    values: F64
    covariance: F64
    residual_px: float
    residuals_px: F64
    corners: int
    tilt_spread_deg: float

    @property
    def matrix(self) -> F64:
        """Get the camera matrix, [3, 3], pixel centres at +0.5."""
        fx, fy, cx, cy = self.values[:4]
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> F64:
        """Get k1, k2, p1, p2."""
        return self.values[4:]

    @property
    def standard_errors(self) -> F64:
        """Get the standard errors of `values`, [8]."""
        return np.sqrt(np.diag(self.covariance))


def estimate_camera(sightings: Sequence[Sighting | None], size: tuple[int, int]) -> CameraEstimate:
    """Estimate intrinsics and distortion.

    Args:
        sightings: The board in each picture; None if it was not found.
        size: Height and width of the pictures.

    Raises:
        CalibrationError: Too few pictures show the board, its corners lie on a line, all poses are parallel, the
            frame is covered too little, residuals are large, or the focal length is too uncertain.
    """
    seen = _usable(sightings, size)
    values, rotations, translations = _minimise(seen, size)
    tilts = _tilt_spread_deg(rotations)
    if tilts < TILT_SPREAD_MIN_DEG:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"the board was held nearly parallel in all {len(seen)} pictures ({tilts:.1f} degrees between the normals)",
            allowed=f"{TILT_SPREAD_MIN_DEG:g} degrees or more between two of them",
            remedy="tilt the board by 20 to 40 degrees to all sides: parallel boards do not determine the focal length",
        )
    pictures = [_picture(*one) for one in zip(seen, [values] * len(seen), rotations, translations, strict=True)]
    estimate = _judge(pictures, size, values, tilts)
    _require_small_residuals(estimate)
    relative = float((estimate.standard_errors[:2] / estimate.values[:2]).max())
    if not np.isfinite(relative) or relative > FOCAL_ERROR_MAX:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"the focal length is known to {100 * relative:.2g} % only",
            allowed=f"{100 * FOCAL_ERROR_MAX:g} %",
            remedy="take more pictures, with the board tilted more and filling more of the frame",
        )
    return estimate


def _usable(sightings: Sequence[Sighting | None], size: tuple[int, int]) -> list[Sighting]:
    """Return the sightings that determine a pose.

    Raises:
        CalibrationError: There are too few, or they cover too little.
    """
    found = [sighting for sighting in sightings if sighting is not None]
    if not found:
        raise CalibrationError(
            STEP,
            Reason.BOARD_NOT_SEEN,
            f"the board is in none of {len(sightings)} pictures",
            remedy="show the board, in focus and lit, and check [calibration.board] against its print",
        )
    seen = [sighting for sighting in found if not sighting.collinear]
    if not seen:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"the corners found lie on one line of the board in all of {len(found)} pictures",
            remedy="show more of the board: corners on one line do not determine its rotation about that line",
        )
    if len(seen) < POSES_MIN:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"{len(seen)} of {len(sightings)} pictures show enough of the board",
            allowed=f"{POSES_MIN} or more",
            remedy="take more pictures with the whole board in the frame",
        )
    span = np.ptp(np.concatenate([sighting.corners_px for sighting in seen]), axis=0) / np.array([size[1], size[0]])
    if span.min() < COVERAGE_MIN:
        raise CalibrationError(
            STEP,
            Reason.DEGENERATE_VIEWS,
            f"all corners together span {100 * span[0]:.0f} % of the width and {100 * span[1]:.0f} % of the height",
            allowed=f"{100 * COVERAGE_MIN:g} % of each",
            remedy="hold the board closer, and once into each corner of the frame",
        )
    return seen


def _minimise(seen: Sequence[Sighting], size: tuple[int, int]) -> tuple[F64, F64, F64]:
    """Minimise the reprojection error; return parameters [8] and poses as rotation vectors and shifts, [V, 3] each."""
    mm = [sighting.corners_mm.astype(np.float32) for sighting in seen]
    px = [(sighting.corners_px - PIXEL_CENTRE).astype(np.float32) for sighting in seen]
    ending = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
    try:
        _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
            mm, px, (size[1], size[0]), None, None, flags=cv2.CALIB_FIX_K3, criteria=ending
        )
    except cv2.error as error:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            "no camera explains these pictures of the board",
            remedy="check [calibration.board] against its print, and that the board is flat and at rest",
        ) from error
    principal = matrix[:2, 2] + PIXEL_CENTRE
    values = np.array([matrix[0, 0], matrix[1, 1], *principal, *np.ravel(distortion)[:4]])
    poses = np.reshape(rotations, (-1, 3)), np.reshape(translations, (-1, 3))
    if not all(np.isfinite(part).all() for part in (values, *poses)):
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            "no camera explains these pictures of the board: the fit diverged",
            remedy="check [calibration.board] against its print, and tilt the board more",
        )
    return values, poses[0].astype(np.float64), poses[1].astype(np.float64)


def project(values: F64, points: F64, rotation: F64, translation: F64) -> tuple[F64, F64, F64]:
    """Project points through a camera, with derivatives.

    Args:
        values: As `CameraEstimate.values`, [8].
        points: [K, 3], mm.
        rotation: Rotation vector, [3].
        translation: [3], mm.

    Returns:
        Pixels [K, 2] (centres at +0.5); derivatives [2 K, 8] by `values` and [2 K, 6] by rotation and translation,
        x and y of a point in turn.
    """
    matrix = np.array([[values[0], 0, values[2]], [0, values[1], values[3]], [0, 0, 1.0]])
    projected, jacobian = cv2.projectPoints(points.reshape(-1, 1, 3), rotation, translation, matrix, values[4:8])
    # OpenCV orders the columns: rotation, translation, fx, fy, cx, cy, k1, k2, p1, p2.
    return np.asarray(projected).reshape(-1, 2), jacobian[:, 6:14], jacobian[:, :6]


@dataclass(frozen=True)
class _Picture:
    """One picture's information about the camera, with its own pose eliminated (Schur complement).

    Args:
        normal: Normal matrix of the 8 parameters, [8, 8].
        pull: Its gradient at the minimum, [8]; those of all pictures sum to zero.
        residual: x and y of each corner in turn, [2 K].
    """

    normal: F64
    pull: F64
    residual: F64


def _picture(sighting: Sighting, values: F64, rotation: F64, translation: F64) -> _Picture:
    at, by_camera, by_pose = project(values, sighting.corners_mm, rotation, translation)
    left = (sighting.corners_px - at).ravel()
    base, _ = np.linalg.qr(by_pose)
    rest = by_camera - base @ (base.T @ by_camera)
    return _Picture(rest.T @ rest, rest.T @ left, left)


def _judge(pictures: Sequence[_Picture], size: tuple[int, int], values: F64, tilts: float) -> CameraEstimate:
    """Turn the minimum into an estimate with its covariance.

    Errors of the corners of one picture are correlated (by the position of edges relative to pixels, by a board that is
    not quite flat), so they contain less information than independent ones. For each parameter the variance is the
    larger of two: that of independent corners, and that of the jackknife over pictures (Efron and Stein, Annals of
    Statistics 9 (1981) 586), enlarged for its few degrees of freedom.
    """
    count = len(pictures)
    every = np.concatenate([picture.residual for picture in pictures])
    freedom = max(len(every) - len(values) - 6 * count, 1)
    normal = np.sum([picture.normal for picture in pictures], axis=0)
    independent = np.linalg.pinv(normal, hermitian=True) * float(every @ every) / freedom
    without = np.stack([-np.linalg.pinv(normal - one.normal, hermitian=True) @ one.pull for one in pictures])
    widened = float(student.ppf(0.975, count - 1)) / 1.96
    scatter = (count - 1) * np.square(without - without.mean(axis=0)).mean(axis=0) * widened**2
    stretch = np.sqrt(np.maximum(scatter / np.diag(independent), 1.0))
    return CameraEstimate(
        size=size,
        values=values,
        covariance=independent * np.outer(stretch, stretch),
        residual_px=float(np.sqrt(every @ every / freedom)),
        residuals_px=np.array([np.sqrt(np.mean(np.square(picture.residual))) for picture in pictures]),
        corners=len(every) // 2,
        tilt_spread_deg=tilts,
    )


def _require_small_residuals(estimate: CameraEstimate) -> None:
    """Check that the residuals of an estimate are small.

    Raises:
        CalibrationError: The residual is large, of all pictures or of one.
    """
    if not estimate.residual_px <= RESIDUAL_MAX_PX:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"the camera explains the corners to {estimate.residual_px:.2g} px only",
            allowed=f"{RESIDUAL_MAX_PX:g} px",
            remedy="use a flat board at rest, in focus, and check [calibration.board] against its print",
        )
    worst = int(np.argmax(estimate.residuals_px))
    typical = max(float(np.median(estimate.residuals_px)), 0.02)  # residuals of hundredths of a pixel are normal
    if estimate.residuals_px[worst] > PICTURE_RESIDUAL_FACTOR * typical:
        raise CalibrationError(
            STEP,
            Reason.BAD_FIT,
            f"picture {worst + 1} of the board fits to {estimate.residuals_px[worst]:.2g} px, the others to "
            f"{typical:.2g} px",
            allowed=f"{PICTURE_RESIDUAL_FACTOR:g} times the others'",
            remedy="take it again with the board at rest",
        )


def _tilt_spread_deg(rotations: F64) -> float:
    """Return the largest angle between two normals of the board, in degrees."""
    normals = np.stack([cv2.Rodrigues(rotation)[0][:, 2] for rotation in rotations])
    return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
