"""A shot's lens: the map between the sensor's pixels and the canvas of a pinhole, and pictures resampled by it.

    sensor    what was measured: masks, measurement, decoded and recovered views, depth
    canvas    the picture of a pinhole with the same focal lengths and optical axis, in which straight lines stay
              straight. On it corners are tracked, poses estimated and depth swept. It is large enough to contain every
              pixel of the sensor; with barrel distortion the sensor's corners see more than its own frame.

The fit needs no canvas: its renderer blends each pixel along that pixel's own ray (`gs2ci.render.sampling`), so that
no view is resampled before it enters the measurement. Here: the canvas, and resampling for the geometry stage. Not
here: the formula (`gs2ci.core.lens`), the renderer (`fit/scene/rendering.py`).
"""

from dataclasses import dataclass
from typing import Final, Literal, Self

import numpy as np
import torch
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.core.errors import InputError
from gs2ci.core.lens import LEAST_STRETCH, pixel_centres, pixels_of, places_of, slopes_of, stretch, undistorted
from gs2ci.core.records import Shot
from gs2ci.render.sampling import CanvasSampling

# A lens that moves no pixel by more than this is treated as a pinhole: corners in decoded views are accurate to a tenth
# of a pixel at best, and calibration boards give nonzero coefficients for every lens.
LEAST_SHIFT_PX: Final = 0.05
# A larger canvas, relative to the sensor, would contain little but the stretched border of a wide lens, at a cost in
# memory and time.
LARGEST_CANVAS: Final = 2.0
# A smaller canvas cannot hold the detail of the sensor, and coefficients so large are a mistake.
SMALLEST_CANVAS: Final = 1 / LARGEST_CANVAS
# Gives interpolation neighbours around every position.
_BORDER_PX: Final = 1
# SciPy and OpenCV put the centre of the first pixel at 0, this project at 0.5.
CENTRE_OFFSET: Final = 0.5


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens that distorts, for one sensor.

    Args:
        intrinsics: Camera matrix of the pinhole in the sensor's pixels, [3, 3].
        sampling: Position of each of the sensor's pixels on the canvas.
        seen_at: Position of each pixel of the canvas on the sensor, as (x, y) in px, [Hc, Wc, 2].
        seen: Whether the sensor sees it, [Hc, Wc].
    """

    intrinsics: F64
    sampling: CanvasSampling
    seen_at: F64
    seen: Bool

    @classmethod
    def of(cls, shot: Shot) -> Self | None:
        """Return a shot's lens; None if its distortion is negligible.

        Raises:
            InputError: It folds the picture over, or its canvas would be far larger or smaller than the sensor.
        """
        if shot.distortion is None or shot.intrinsics is None:
            return None
        intrinsics, coefficients = shot.intrinsics.astype(np.float64), shot.distortion.astype(np.float64)
        pixels = pixel_centres(shot.size)
        places = pixels_of(undistorted(slopes_of(pixels, intrinsics), coefficients), intrinsics)
        if np.abs(places - pixels).max() <= LEAST_SHIFT_PX:
            return None
        _check_canvas(places, shot.size)
        sampling = CanvasSampling.around(places, _BORDER_PX)
        rays = slopes_of(pixel_centres(sampling.canvas) + sampling.origin, intrinsics)
        seen_at = places_of(rays, intrinsics, coefficients)
        frame = np.array([shot.size[1], shot.size[0]], np.float64)
        seen_at = np.clip(seen_at, -frame, 2 * frame)  # positions farther outside are not needed
        inside = (seen_at >= 0) & (seen_at <= frame)
        seen = inside.all(axis=-1) & (stretch(rays, coefficients) >= LEAST_STRETCH)
        return cls(intrinsics, sampling, seen_at, seen)

    @property
    def canvas_intrinsics(self) -> F64:
        """Get the camera matrix of the canvas, [3, 3]: the pinhole's, with pixels counted from the canvas's corner."""
        return self.sampling.intrinsics_of_canvas(torch.from_numpy(self.intrinsics)).numpy()

    def straightened(self, views: F32) -> F32:
        """Resample the sensor's views, [N, H, W, C], to the canvas, [N, Hc, Wc, C]; unseen pixels repeat the border."""
        # A cubic spline displaces the picture by less than a hundredth of a pixel; OpenCV's cubic kernel displaces it
        # by up to 0.06 px, in directions that vary over the picture.
        return _resampled(views, self.seen_at, order=3)

    def bent(self, views: F32) -> F32:
        """Resample views of the canvas, [N, Hc, Wc, C], to the sensor, [N, H, W, C]."""
        return _resampled(views, self.sampling.places, order=1)


def straightened(views: F32, lens: Lens | None) -> F32:
    """Resample views, [N, H, W, C], to a pinhole's, [N, Hc, Wc, C]: unchanged without a lens."""
    return views if lens is None else lens.straightened(views)


def _check_canvas(places: F64, size: Size) -> None:
    wide, high = np.ptp(places, axis=(0, 1)) + 1
    shares = high / size[0], wide / size[1]
    if max(shares) > LARGEST_CANVAS or min(shares) < SMALLEST_CANVAS:
        raise InputError(
            f"without its distortion this lens sees {high:.0f} x {wide:.0f} px with a sensor of {size[0]} x {size[1]}",
            allowed=f"{SMALLEST_CANVAS:g} to {LARGEST_CANVAS:g} times the sensor along each side",
            remedy="check the coefficients, or crop masks, measurement and camera matrix to the middle of the frame",
        )


def _resampled(views: F32, places: F64, order: Literal[1, 3]) -> F32:
    """Interpolate views, [N, H, W, C], at positions, [h, w, 2]; beyond the border it is repeated."""
    at = np.moveaxis(places, -1, 0)[::-1] - CENTRE_OFFSET
    shown = np.empty((len(views), *places.shape[:2], views.shape[3]), np.float32)
    for view, channel in np.ndindex(len(views), views.shape[3]):
        shown[view, ..., channel] = map_coordinates(views[view, ..., channel], at, order=order, mode="nearest")
    # Splines overshoot beside edges; resampling must not extend the range of values.
    return np.clip(shown, views.min(), views.max(), out=shown)
