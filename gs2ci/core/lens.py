"""Lens distortion in OpenCV's convention: from slopes of rays to slopes on the sensor, back, and a validity check.

With x = X/Z and y = Y/Z the slopes of a ray, r² = x² + y² and coefficients k1 k2 p1 p2 k3, the sensor sees it at

    x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

in the same unit, of which the camera matrix makes pixels (Brown, Photogrammetric Engineering 32 (1966) 444; OpenCV,
"Camera Calibration and 3D Reconstruction"). Here: this map, its inverse, rays, what a view shows, the check. Not here:
pictures (`gs2ci.reconstruct.measurement.lens`), measuring the coefficients (`gs2ci_calibration`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.cameras import in_camera
from gs2ci.core.errors import InputError

COEFFICIENTS: Final = ("k1", "k2", "p1", "p2", "k3")
# Least determinant of the map: where it reaches 0 the picture folds. If a lens compresses a patch of the scene to a
# twentieth of its area on the sensor, nothing of it can be recovered.
LEAST_STRETCH: Final = 0.05
# No lens has such coefficients, and with slopes up to 10⁹ their terms stay inside float64.
COEFFICIENT_LIMIT: Final = 1e12
# The inverse is followed from the axis outwards in this many steps, each corrected by this many Newton steps; between
# two steps the map is nearly linear, so that the root is the one connected to the axis, not one beyond a fold.
_STEPS: Final = 4
_STEPS_OF_CHECK: Final = 32
_CORRECTIONS: Final = 2
_LAST_CORRECTIONS: Final = 8
# Rounding leaves 1e-16 of the slope; a larger remainder means that it did not converge.
_CONVERGED: Final = 1e-9
# Folds are searched for at this many places along each side of the frame.
_CHECKED: Final = 33


def distorted(slopes: F64, coefficients: F64) -> F64:
    """Distort slopes of rays, [..., 2] as (x, y), into slopes on the sensor, [..., 2]."""
    k1, k2, p1, p2, k3 = (float(value) for value in coefficients)
    x, y = slopes[..., 0], slopes[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    bent_y = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack([bent_x, bent_y], axis=-1)


def stretch(slopes: F64, coefficients: F64) -> F64:
    """Return the area scale of the map at slopes of rays, [..., 2] -> [...]; not positive beyond a fold."""
    xx, xy, yy = _jacobian(slopes, coefficients)
    determinant: F64 = xx * yy - xy * xy
    # Beyond two folds the determinant is positive again, with both directions reversed.
    return np.where(xx + yy > 0, determinant, -np.abs(determinant))


def undistorted(slopes: F64, coefficients: F64) -> F64:
    """Return the rays, [..., 2], of slopes on the sensor, [..., 2].

    Raises:
        InputError: The picture folds between the axis and such a slope.
    """
    return _followed(slopes, coefficients, _STEPS)


def check_distortion(coefficients: NDArray[Any], intrinsics: F64, size: tuple[int, int]) -> None:
    """Check that a lens with these coefficients is invertible within the frame.

    Args:
        coefficients: k1 k2 p1 p2 k3.
        intrinsics: Camera matrix in pixels, [3, 3], checked.
        size: Height and width of the frame, px.

    Raises:
        InputError: Not [5], not finite or absurd, or the picture folds within the frame.
    """
    if coefficients.shape != (len(COEFFICIENTS),):
        raise InputError(f"distortion has shape {list(coefficients.shape)}", allowed="[5]: k1 k2 p1 p2 k3")
    if not (np.abs(coefficients) <= COEFFICIENT_LIMIT).all():
        raise InputError(f"distortion {coefficients.tolist()}", allowed=f"finite numbers within ±{COEFFICIENT_LIMIT:g}")
    height, width = size
    columns, rows = np.meshgrid(np.linspace(0, width, _CHECKED), np.linspace(0, height, _CHECKED))
    _followed(slopes_of(np.stack([columns, rows], axis=-1), intrinsics), coefficients, _STEPS_OF_CHECK)


def slopes_of(pixels: F64, intrinsics: F64) -> F64:
    """Turn pixels of a pinhole camera, [..., 2] as (x, y), into slopes, [..., 2]."""
    focal, centre = np.diag(intrinsics)[:2], intrinsics[:2, 2]
    return (pixels - centre) / focal


def pixels_of(slopes: F64, intrinsics: F64) -> F64:
    """Turn slopes, [..., 2] as (x, y), into pixels of a pinhole camera, [..., 2]."""
    return slopes * np.diag(intrinsics)[:2] + intrinsics[:2, 2]


def pixel_centres(size: tuple[int, ...]) -> F64:
    """List the pixel centres of an image of a height and width as (x, y), [H, W, 2]."""
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    return np.stack([columns, rows], axis=-1)


def rays_of(pixels: F64, intrinsics: F64, distortion: F64 | None = None) -> F64:
    """Return the rays of pixels, [..., 2] as (x, y), in the camera's axes at z = 1, [..., 3]; no distortion: a pinhole.

    Raises:
        InputError: The picture folds between the axis and such a pixel.
    """
    slopes = slopes_of(pixels, intrinsics)
    if distortion is not None:
        slopes = undistorted(slopes, distortion)
    return np.concatenate([slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)


def places_of(slopes: F64, intrinsics: F64, distortion: F64 | None = None) -> F64:
    """Return where a sensor sees rays of slopes, [..., 2] as (x, y): pixels, [..., 2]; no distortion: a pinhole."""
    return pixels_of(slopes if distortion is None else distorted(slopes, distortion), intrinsics)


def seen_by(
    points: F64, world_to_camera: F64, intrinsics: F64, size: tuple[int, ...], distortion: F64 | None = None
) -> tuple[Bool, F64, F64]:
    """Project points, [P, 3], into a view of a pose, [4, 4], and a size (height, width); no distortion: a pinhole.

    Returns:
        Which of them fall into it, [P]; how far ahead each lies, [P]; and their places, [P, 2] as (x, y) px, which
        mean something only where the first is true.
    """
    local = in_camera(points, world_to_camera)
    ahead = local[:, 2]
    before = ahead > 1e-9 * max(float(np.abs(ahead).max(initial=0.0)), 1e-300)
    slopes = local[:, :2] / np.where(before, ahead, 1.0)[:, None]
    if distortion is not None:
        # Far outside the frame the lens's polynomial folds back into it.
        before &= stretch(slopes, distortion) > 0
    pixels = places_of(slopes, intrinsics, distortion)
    inside = before & (pixels >= 0).all(axis=1) & (pixels < (size[1], size[0])).all(axis=1)
    return inside, ahead, pixels


def _jacobian(slopes: F64, coefficients: F64) -> tuple[F64, F64, F64]:
    """Differentiate `distorted`: ∂x'/∂x, ∂x'/∂y = ∂y'/∂x, ∂y'/∂y."""
    k1, k2, p1, p2, k3 = (float(value) for value in coefficients)
    x, y = slopes[..., 0], slopes[..., 1]
    square = x * x + y * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    slope = 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    return (
        radial + x * x * slope + 2 * p1 * y + 6 * p2 * x,
        x * y * slope + 2 * p1 * x + 2 * p2 * y,
        radial + y * y * slope + 6 * p1 * y + 2 * p2 * x,
    )


def _followed(slopes: F64, coefficients: F64, steps: int) -> F64:
    """Invert the map by following its solution from the axis outwards.

    Raises:
        InputError: There is no such solution.
    """
    rays = np.zeros(slopes.shape)
    # If there is no solution, Newton's steps diverge, which the checks below detect.
    with np.errstate(all="ignore"):
        for step in range(1, steps + 1):
            aim = slopes * (step / steps)
            # The first of these is the tangent's prediction.
            for _ in range(1 + (_LAST_CORRECTIONS if step == steps else _CORRECTIONS)):
                xx, xy, yy = _jacobian(rays, coefficients)
                left = aim - distorted(rays, coefficients)
                turned = np.stack(
                    [yy * left[..., 0] - xy * left[..., 1], xx * left[..., 1] - xy * left[..., 0]], axis=-1
                )
                rays = rays + turned / (xx * yy - xy * xy)[..., None]
                if np.abs(left).max(initial=0.0) <= _CONVERGED:  # after this step the remainder is its square
                    break
            least = stretch(rays, coefficients).min(initial=np.inf)
            if not least >= LEAST_STRETCH:
                _refuse(coefficients)
        left = np.abs(distorted(rays, coefficients) - slopes)
    if not (left <= _CONVERGED * (1 + np.abs(slopes))).all():
        _refuse(coefficients)
    return rays


def _refuse(coefficients: F64) -> None:
    named = ", ".join(f"{name} = {value:g}" for name, value in zip(COEFFICIENTS, coefficients, strict=True))
    raise InputError(
        f"the distortion ({named}) folds the picture over within the frame, or bends it too sharply to be undone",
        allowed="a lens that shows each place of the scene once",
        remedy="check that the coefficients stand in the order k1 k2 p1 p2 k3 and belong to this camera matrix",
    )
