"""Chessboard corners to a hundredth of a pixel: two blurred edges are fitted to the brightness around each corner.

OpenCV's `cornerSubPix` uses the gradients of a square window, which contains either few pixels or a marker; the fit
here follows the edges for nearly half a square to all four sides and stays between the markers.
`python -m tests.benchmarks calibration_geometry` compares the two. Not here: finding the corners (`board`, the only
user beside tests).
"""

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from gs2ci.core.arrays import F64

ARM: Final = 0.42
"""How far along the edges pixels are used, in squares: short of the next corner and its blur."""
CLEAR_PX: Final = 1.0
"""Pixels nearer than this to a marker are not used: it affects them through the pixel's size and the blur."""
PIXELS_MIN: Final = 30
"""Fewest pixels of a fit: three for each of the ten unknowns."""
PASSES: Final = 12
STEP_MAX: Final = 0.1
"""Longest step of an iteration, in squares: the start is within a pixel."""
ROUGH: Final = 1e-2
"""Step in squares at which the first fit ends: some tenths of a pixel; convergence is quadratic."""
FINE: Final = 1e-4
MOVED_MAX_PX: Final = 2.5
"""If the fit moves a corner further than this, it has found another edge."""
CONTRAST_MIN: Final = 10.0
"""Smallest half difference between black and white, if the whole image has the range 255."""
START_BLUR_PX: Final = 0.7
BLUR_RANGE_PX: Final = (0.1, 8.0)
"""Range of p, without the pixel's own width; at 0 the derivatives would vanish almost everywhere."""


def refine_corners(image: NDArray[np.floating], rough_px: F64, on_board: F64, gap: float) -> tuple[F64, F64]:
    """Fit the corners of a chessboard.

    Around a corner the brightness is m + a E(u, p) E(v, q), with u and v the distances from two edges that cross there
    and E(u, p) the mean of erf(u / p) over a pixel: without that mean a sharp edge along the rows is up to 0.07 px
    off, depending on its position relative to the pixels. The unknowns are the crossing, the edges' directions and
    curvatures (a lens of -0.1 r^2 bends them by some hundredths of a pixel, which would move the crossing), their blurs
    p and q, m and a; solved by Gauss-Newton. Blurs wider than the gap to the markers are underestimated; the crossing,
    by symmetry, is not affected.

    Args:
        image: [H, W], black to white 0 to 255.
        rough_px: Rough positions of the corners, [K, 2] x and y, pixel centres at +0.5; K >= 4.
        on_board: Their positions on the board, [K, 2], in squares.
        gap: Distance between edges and markers, in squares.

    Returns:
        The corners, [K, 2] pixels, and the standard deviation of the blur of their edges, [K] pixels; NaN marks a
        corner that could not be fitted.
    """
    board_from_px = cv2.findHomography(rough_px, on_board)[0]
    refined, blur_px = rough_px.copy(), np.full(len(rough_px), np.nan)
    if board_from_px is None:
        return refined, blur_px
    for k, start_px in enumerate(rough_px):
        # The whole board's homography is inaccurate because of the lens's distortion; only its local slope is used.
        slope = _slope(board_from_px, start_px)
        found = _fit_one(image, start_px, slope, gap, ROUGH)
        # The refined corner shows which pixels are clear of markers: choose them again.
        found = _fit_one(image, found[0], slope, gap, FINE) if found is not None else None
        if found is not None:
            refined[k], blur_px[k] = found
    return refined, blur_px


def _slope(homography: F64, point: F64) -> F64:
    """Return the derivative of a homography at a point, [2, 2]."""
    mapped = homography @ np.array([*point, 1.0])
    return (homography[:2, :2] - np.outer(mapped[:2] / mapped[2], homography[2, :2])) / mapped[2]


def _fit_one(
    image: NDArray[np.floating], start_px: F64, slope: F64, gap: float, last_step: float
) -> tuple[F64, float] | None:
    """Fit one corner and its blur; None if too few pixels are clear, or the fit diverges."""
    across, values, squares_per_px = _clear_pixels(image, start_px, slope, gap)
    if len(values) < PIXELS_MIN:
        return None
    unknowns = _start(across, values, squares_per_px)
    low, high = (np.array([squares_per_px[0], squares_per_px[1]]) * side for side in BLUR_RANGE_PX)
    for _ in range(PASSES):
        residual, jacobian = _model(unknowns, across, values, 0.5 * squares_per_px)
        step, *_ = np.linalg.lstsq(jacobian, residual, rcond=None)
        scale = min(1.0, STEP_MAX / max(float(np.abs(step[:8]).max()), 1e-12))
        unknowns = unknowns + scale * step
        unknowns[6:8] = np.clip(unknowns[6:8], low, high)
        if np.abs(step[:2]).max() < last_step:
            break
    if not np.isfinite(unknowns).all() or abs(unknowns[9]) < CONTRAST_MIN:
        return None
    moved_px = np.linalg.solve(slope, _crossing(unknowns))
    if np.linalg.norm(moved_px) >= MOVED_MAX_PX:
        return None
    # erf(u / p) is an edge blurred by a Gaussian of p / sqrt(2).
    return start_px + moved_px, float(np.mean(unknowns[6:8] / squares_per_px) / np.sqrt(2))


def _clear_pixels(image: NDArray[np.floating], start_px: F64, slope: F64, gap: float) -> tuple[F64, F64, F64]:
    """Return the pixels between the markers: places relative to the corner in squares [P, 2], values [P], px size."""
    px_per_square = np.linalg.inv(slope)
    reach = np.ceil(ARM * np.abs(px_per_square).sum(axis=1)).astype(int) + 1
    middle = np.floor(start_px).astype(int)
    # Both ends are clipped to the image: a corner outside of it has no pixels.
    (top, left), (bottom, right) = (
        np.clip(middle[::-1] + way * reach[::-1] + (way + 1) // 2, 0, image.shape) for way in (-1, 1)
    )
    y, x = np.mgrid[top:bottom, left:right] + 0.5
    offsets = np.stack([x.ravel() - start_px[0], y.ravel() - start_px[1]], axis=1)
    places = offsets @ slope.T
    pixel = np.abs(slope).sum(axis=1)  # a pixel's extent on the board along u and v
    size = np.linalg.norm(slope, axis=1)
    room = np.maximum(gap - CLEAR_PX * size, 0.5 * pixel)
    near_edge = (np.abs(places) < room).any(axis=1)
    keep = near_edge & (np.abs(places) < ARM).all(axis=1)
    return places[keep], image[top:bottom, left:right].ravel()[keep].astype(np.float64), size


def _start(places: F64, values: F64, squares_per_px: F64) -> F64:
    sign = np.sign(places[:, 0] * places[:, 1])
    white, black = values[sign > 0], values[sign < 0]
    ends = (white.mean() if len(white) else 0.0, black.mean() if len(black) else 0.0)
    blur = START_BLUR_PX * squares_per_px
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *blur, 0.5 * (ends[0] + ends[1]), 0.5 * (ends[0] - ends[1])])


def _model(unknowns: F64, places: F64, values: F64, half_pixel: F64) -> tuple[F64, F64]:
    """Return values minus model, [P], and the model's derivatives, [P, 10]; `half_pixel` along u and v, in squares."""
    u0, v0, turn_u, turn_v, bend_u, bend_v, p, q, mean, half = unknowns
    x, y = places.T
    u, v = x - u0 + turn_u * y + bend_u * y * y, y - v0 + turn_v * x + bend_v * x * x
    (eu, gu, pu), (ev, gv, pv) = _edge(u, p, half_pixel[0]), _edge(v, q, half_pixel[1])
    by_u, by_v = half * gu * ev, half * eu * gv
    columns = (-by_u, -by_v, by_u * y, by_v * x, by_u * y * y, by_v * x * x, half * pu * ev, half * eu * pv)
    return values - (mean + half * eu * ev), np.stack([*columns, np.ones_like(x), eu * ev], axis=1)


def _edge(u: F64, p: float, h: float) -> tuple[F64, F64, F64]:
    """Return the mean of erf(u / p) from u - h to u + h, and its derivatives by u and by p.

    The integral of erf(u / p) is u erf(u / p) + p exp(-u^2 / p^2) / sqrt(pi).
    """
    right, left = (u + h) / p, (u - h) / p
    erf_right, erf_left = erf(right), erf(left)
    bell_right, bell_left = (np.exp(-np.square(side)) / np.sqrt(np.pi) for side in (right, left))
    mean = p * (right * erf_right + bell_right - left * erf_left - bell_left) / (2 * h)
    return mean, (erf_right - erf_left) / (2 * h), (bell_right - bell_left) / (2 * h)


def _crossing(unknowns: F64) -> F64:
    """Return where the two edges cross, relative to the start, in squares, [2]; curvature is negligible so near."""
    u0, v0, turn_u, turn_v = unknowns[:4]
    edges: Any = np.array([[1.0, turn_u], [turn_v, 1.0]])
    return np.linalg.solve(edges, np.array([u0, v0]))
