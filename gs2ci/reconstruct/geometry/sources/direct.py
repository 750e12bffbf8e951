"""Geometry without tracks: depths along given poses, with the smallest residual of the measurement.

Tracks need points that can be followed from view to view. If decoded views are too poor for that, because of many masks
or a plain scene, the measurement can still tell a right path from a wrong one: warped along the right path, the middle
view explains the measurement clearly better than along the reversed path or at rest. Here: the range of depths along
given poses. Not here: the residual (`evidence`), the sweep (`sweep`), when this is used (`sources`).

Direct methods, in the sense of Irani and Anandan 1999: parameters are found from brightness itself, not from points.
"""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.depth.sweep import features_of, reduced, sweep, sweep_features
from gs2ci.reconstruct.geometry.evidence import Evidence
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry, flat_geometry
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.path.focal import Focal
from gs2ci.reconstruct.geometry.prior import Request

# Tried shifts of the nearest plane between the middle view and the farthest, as shares of the picture's longer side:
# few views see what shifts by a third of it.
_NEAREST: Final = (0.02, 0.04, 0.08, 0.16, 0.32)
# The residual of a path must be at most this share of those of its reverse and of a camera at rest.
_CLEARLY: Final = 0.98
# Paths are compared by rough depth maps of so many planes, pixels and views, at so many pixels of the measurement.
_ROUGH: Final = {"planes": 20, "most_pixels": 2_500}
_ROUGH_VIEWS: Final = 7
_ASKED_PIXELS: Final = 6_000


class Direct:
    """Judges paths by the measurement.

    Args:
        request: The measurement and its views.
        found: The tracks' geometry, of which the camera matrix and the middle view are used.
    """

    def __init__(self, request: Request, found: Geometry) -> None:
        views, reference = len(request.views), found.reference
        self._request = request
        self._at_rest = at_rest(found)
        self._evidence = Evidence(request.shot, request.views, request.lens, _ASKED_PIXELS)
        spread = np.linspace(0, views - 1, min(views, _ROUGH_VIEWS)).round().astype(int)
        looked_at = np.union1d(spread, [reference])
        small = reduced(request.views[looked_at], _ROUGH["most_pixels"])
        self._shrink = np.array([small.shape[2] / request.size[1], small.shape[1] / request.size[0], 1.0])
        self._others = looked_at[looked_at != reference]
        # The middle view first.
        order = np.argsort(looked_at != reference, kind="stable")
        self._rough = replace(request.settings.sweep, **_ROUGH)
        self._features = features_of(small[order], self._rough.blur_px)
        # If the farthest view of a path is this far from the middle one, a plane at inverse depth ρ shifts by ρ times
        # the picture's longer side.
        self._reach = max(request.size) / float(found.intrinsics[0, 0])
        self._still = self._evidence.left(self._at_rest)

    def along(self, world_to_camera: F64) -> Geometry | None:
        """Estimate the depths along given poses, [N, 4, 4], in any frame and unit.

        Returns:
            The geometry; None if the reversed path or a camera at rest explains the measurement about as well.
        """
        poses = world_to_camera @ np.linalg.inv(world_to_camera[self._at_rest.reference])
        farthest = float(np.linalg.norm(poses[:, :3, 3], axis=1).max())
        if farthest == 0:
            return None
        poses[:, :3, 3] *= self._reach / farthest
        left, near = self._best(poses)
        if left >= _CLEARLY * min(self._still, self._best(_reversed(poses))[0]):
            return None
        return self._swept(poses, near)

    def _best(self, poses: F64) -> tuple[float, float]:
        """Return the residual of the best of several ranges of depth, and its nearest plane."""
        return min((self._left(poses, near), near) for near in _NEAREST)

    def _left(self, poses: F64, near: float) -> float:
        """Return the residual of poses with a rough map of their depths."""
        intrinsics = self._shrink[:, None] * self._at_rest.intrinsics
        rough = sweep_features(self._features, poses[self._others], intrinsics, self._span(near), self._rough)
        depth: F32 = cv2.resize(rough, self._request.size[::-1], interpolation=cv2.INTER_LINEAR)
        return self._evidence.left(replace(self._at_rest, world_to_camera=poses, inverse_depth=depth))

    def _swept(self, poses: F64, near: float) -> Geometry:
        """Sweep depth finely, and scale its median to 1, as with tracks."""
        request, still = self._request, self._at_rest
        span, settings = self._span(near), request.settings.sweep
        depth = sweep(request.views, poses, still.intrinsics, still.reference, span, settings)
        median = float(np.median(depth))
        scaled = poses.copy()
        scaled[:, :3, 3] *= median
        return replace(still, world_to_camera=scaled, inverse_depth=depth / np.float32(median), verdict=Verdict.FULL)

    def _span(self, near: float) -> tuple[float, float]:
        return self._request.settings.sweep.far_share * near, near


def at_rest(found: Geometry) -> Geometry:
    """Return a camera at rest in front of a plane: the geometry without its motion, its depth and the notes on them."""
    notes = tuple(note for note in found.notes if note != PLANE_NOTE)
    camera, (height, width) = Focal(found.intrinsics, found.focal_source, notes), found.inverse_depth.shape
    flat = flat_geometry(len(found.world_to_camera), (height, width), camera)
    return replace(flat, reference=found.reference, source=found.source)


def _reversed(poses: F64) -> F64:
    """Reverse the camera's travel and keep its turns."""
    back = poses.copy()
    back[:, :3, 3] *= -1
    return back
