"""How well a geometry explains the measurement, before anything is fitted.

The middle view, warped to the other poses by its depth, should look like the other views; coded by the masks, these
should give the measurement. The residual compares geometries of any origin on equal terms, since wrong poses and wrong
depths increase it. Here: the warped views and that residual. Not here: the warping of single positions (`carrying`),
the choice (`choose`), geometries estimated by this residual (`direct`).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.lens import pixel_centres
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.depth.carrying import carried_places
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.reconstruct.measurement.lens import Lens

# OpenCV's limit on the number of positions in one call.
_MOST_AT_ONCE: Final = 32_000


class Evidence:
    """Judges geometries by their residual at pixels of a measurement.

    Args:
        shot: The measurement without its held-out pixels.
        views: Proxy views, [N, H, W, C]; the middle one is used.
        lens: Through which the measurement was taken; views and geometries then refer to its canvas.
        most_pixels: Use at most so many pixels, drawn once; None uses all.
    """

    def __init__(self, shot: Shot, views: F32, lens: Lens | None = None, most_pixels: int | None = None) -> None:
        rows, columns = np.nonzero(shot.usable)
        if most_pixels is not None and len(rows) > most_pixels:
            asked = np.sort(np.random.default_rng(0).choice(len(rows), most_pixels, replace=False))
            rows, columns = rows[asked], columns[asked]
        self._views = views
        self._measured = shot.measurement[rows, columns]
        places = pixel_centres(shot.size)[rows, columns] if lens is None else lens.sampling.places[rows, columns]
        channels = None if shot.cfa is None else cfa_channels(shot.cfa, shot.size).numpy()[rows, columns, None]
        # For every view: which pixels its mask lets through, their positions, transmissions and channels.
        self._lit = []
        for transmissions in shot.masks[:, rows, columns] * shot.weights[:, None]:
            lit = np.flatnonzero(transmissions)
            seen = None if channels is None else channels[lit]
            self._lit.append((lit, places[lit], transmissions[lit, None], seen))

    def left(self, geometry: Geometry) -> float:
        """Return the measurement's residual by the warped middle view, root mean square in the measurement's unit.

        Positions outside the picture take the value of its nearest border pixel, so that a path that looks away from
        the scene gains nothing.
        """
        reference = self._views[geometry.reference]
        left = -self._measured.astype(np.float32)
        for view, (lit, places, transmissions, channels) in enumerate(self._lit):
            carried = _carried(reference, geometry, view, places)
            if channels is not None:
                carried = np.take_along_axis(carried, channels, axis=1)
            left[lit] += transmissions * carried
        return float(np.sqrt(np.mean(left**2, dtype=np.float64))) if left.size else 0.0


def unexplained(shot: Shot, views: F32, geometry: Geometry, lens: Lens | None = None) -> float:
    """Return a geometry's residual over a whole measurement; see `Evidence`."""
    return Evidence(shot, views, lens).left(geometry)


def carried_views(views: F32, geometry: Geometry, lens: Lens | None = None) -> F32:
    """Warp the middle one of views, [N, H, W, C], to what the sensor should see from every pose of a geometry.

    With a lens, views and geometry refer to its canvas, and the result, [N, H, W, C], has the sensor's size.
    """
    carried = np.stack([carried_view(views[geometry.reference], geometry, i) for i in range(len(views))])
    return carried if lens is None else lens.bent(carried)


def carried_view(reference: F32, geometry: Geometry, view: int) -> F32:
    """Warp the middle view, [H, W, C], to another pose, by its depth and without occlusion."""
    height, width = reference.shape[:2]
    places = pixel_centres((height, width)).reshape(-1, 2)
    return _carried(reference, geometry, view, places).reshape(reference.shape)


def _carried(reference: F32, geometry: Geometry, view: int, places: F64) -> F32:
    """Sample the middle view, [H, W, C], for positions in another view, [P, 2] px; [P, C]."""
    intrinsics = np.ascontiguousarray(geometry.intrinsics, np.float64)
    pose = np.ascontiguousarray(geometry.world_to_camera[view], np.float64)
    depth = np.ascontiguousarray(geometry.inverse_depth)
    wanted = carried_places(places, depth, pose, intrinsics, np.asarray(np.linalg.inv(intrinsics), np.float64))
    pieces = [
        cv2.remap(
            reference, wanted[i : i + _MOST_AT_ONCE, None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for i in range(0, len(wanted), _MOST_AT_ONCE)
    ]
    shown: F32 = np.concatenate(pieces) if pieces else np.zeros((0, 1), np.float32)
    return shown.reshape(len(wanted), reference.shape[2])
