"""What the measurement itself says of a geometry, before anything is fitted.

The middle view, carried along the poses through its depth, should look like the other views; coded by the masks, it
should give the measurement. What is left over compares geometries of any origin on equal terms: wrong poses and wrong
depths smear it. Here: the views as carried, and that number. Not here: which place is carried where (`carrying`), the
choice (`choose`), geometries sought by that number (`direct`).
"""

from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.carrying import carried_places
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.reconstruct.measurement.lens import Lens, pixel_centres

# OpenCV looks up fewer places than this at once.
_MOST_AT_ONCE: Final = 32_000


class Evidence:
    """Pixels of a measurement that judge geometries.

    Args:
        shot: The measurement as far as it may be seen.
        views: Proxy views, [N, H, W, C]; the middle one is looked at.
        lens: Through which the measurement was taken; views and geometries are then its canvas's.
        most_pixels: Ask so many of the pixels at most, drawn once; None asks all.
    """

    def __init__(self, shot: Shot, views: F32, lens: Lens | None = None, most_pixels: int | None = None) -> None:
        coded = shot.lit
        if shot.saturated is not None:
            coded &= ~shot.saturated
        rows, columns = np.nonzero(coded)
        if most_pixels is not None and len(rows) > most_pixels:
            asked = np.sort(np.random.default_rng(0).choice(len(rows), most_pixels, replace=False))
            rows, columns = rows[asked], columns[asked]
        self._views = views
        self._measured = shot.measurement[rows, columns]
        places = pixel_centres(shot.size)[rows, columns] if lens is None else lens.sampling.places[rows, columns]
        channels = None if shot.cfa is None else cfa_channels(shot.cfa, shot.size).numpy()[rows, columns, None]
        # Of every view: which of the pixels its mask lets through, where they are, how much, and in which channel.
        self._lit = []
        for transmissions in shot.masks[:, rows, columns] * shot.weights[:, None]:
            lit = np.flatnonzero(transmissions)
            seen = None if channels is None else channels[lit]
            self._lit.append((lit, places[lit], transmissions[lit, None], seen))

    def left(self, geometry: Geometry) -> float:
        """Return the root mean square of the measurement that the carried middle view leaves, in its unit.

        Pixels that the geometry sends outside take the nearest at the rim, so that a path that looks elsewhere gains
        nothing by it.
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
    """Return what a geometry leaves of a whole measurement; see `Evidence`."""
    return Evidence(shot, views, lens).left(geometry)


def carried_views(views: F32, geometry: Geometry, lens: Lens | None = None) -> F32:
    """Show the middle one of views, [N, H, W, C], as the sensor should see it from every pose of a geometry.

    Behind a lens, views and geometry are its canvas's, and the result, [N, H, W, C], has the sensor's size.
    """
    carried = np.stack([carried_view(views[geometry.reference], geometry, i) for i in range(len(views))])
    return carried if lens is None else lens.bent(carried)


def carried_view(reference: F32, geometry: Geometry, view: int) -> F32:
    """Show the middle view, [H, W, C], as it should look from another pose, by its depth and without occlusion."""
    height, width = reference.shape[:2]
    places = pixel_centres((height, width)).reshape(-1, 2)
    return _carried(reference, geometry, view, places).reshape(reference.shape)


def _carried(reference: F32, geometry: Geometry, view: int, places: F64) -> F32:
    """Show the middle view, [H, W, C], at places of another, [P, 2] px; [P, C]."""
    intrinsics = np.ascontiguousarray(geometry.intrinsics, np.float64)
    pose = np.ascontiguousarray(geometry.world_to_camera[view], np.float64)
    depth = np.ascontiguousarray(geometry.inverse_depth)
    wanted = carried_places(places, depth, pose, intrinsics, np.linalg.inv(intrinsics))
    pieces = [
        cv2.remap(
            reference, wanted[i : i + _MOST_AT_ONCE, None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        for i in range(0, len(wanted), _MOST_AT_ONCE)
    ]
    shown: F32 = np.concatenate(pieces) if pieces else np.zeros((0, 1), np.float32)
    return shown.reshape(len(wanted), reference.shape[2])
