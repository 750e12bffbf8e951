"""Geometry without tracks: depths along given poses, with the smallest residual of the measurement.

Tracks need points that can be followed from view to view. If decoded views are too poor for that, because of many masks
or a plain scene, the measurement can still tell a right path from a wrong one: warped along the right path, the middle
view explains the measurement clearly better than along the reversed path or at rest. Here: the range of depths along
given poses. Not here: the residual (`evidence`), the sweep (`sweep`), when this is used (`sources`).

Direct methods, in the sense of Irani and Anandan 1999: parameters are found from brightness itself, not from points.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import relative_to
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, sweep
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
# Paths are compared by rough depth maps of so many planes and pixels, at so many pixels of the measurement.
_ROUGH: Final = {"planes": 20, "most_pixels": 2_500}
_ASKED_PIXELS: Final = 6_000


def swept_along(request: Request, found: Geometry, world_to_camera: F64) -> Geometry | None:
    """Estimate the depths along given poses, [N, 4, 4], in any frame and unit.

    Args:
        request: The measurement and its views.
        found: The tracks' geometry, of which the camera matrix and the middle view are used.
        world_to_camera: The poses.

    Returns:
        The geometry; None if the reversed path or a camera at rest explains the measurement about as well.
    """
    still, settings = at_rest(found), request.settings.sweep
    poses = relative_to(world_to_camera, still.reference)
    farthest = float(np.linalg.norm(poses[:, :3, 3], axis=1).max())
    if farthest == 0:
        return None
    # Then a plane at inverse depth ρ shifts by ρ times the picture's longer side in the farthest view.
    poses[:, :3, 3] *= max(request.size) / float(still.intrinsics[0, 0]) / farthest
    back = poses.copy()
    back[:, :3, 3] *= -1
    evidence = Evidence(request.shot, request.views, request.lens, _ASKED_PIXELS)

    def swept(path: F64, near: float, how: SweepSettings) -> Geometry:
        span = (settings.far_share * near, near)
        depth = sweep(request.views, path, still.intrinsics, still.reference, span, how)
        return replace(still, world_to_camera=path, inverse_depth=depth, verdict=Verdict.FULL)

    def best(path: F64) -> tuple[float, float]:
        """Return the residual of the best of several ranges of depth, and its nearest plane."""
        return min((evidence.left(swept(path, near, replace(settings, **_ROUGH))), near) for near in _NEAREST)

    left, near = best(poses)
    if left >= _CLEARLY * min(evidence.left(still), best(back)[0]):
        return None
    fine = swept(poses, near, settings)
    # Scaled to a median of 1, as with tracks.
    median = float(np.median(fine.inverse_depth))
    poses[:, :3, 3] *= median
    return replace(fine, world_to_camera=poses, inverse_depth=fine.inverse_depth / np.float32(median))


def at_rest(found: Geometry) -> Geometry:
    """Return a camera at rest in front of a plane: the geometry without its motion, its depth and the notes on them."""
    notes = tuple(note for note in found.notes if note != PLANE_NOTE)
    camera, (height, width) = Focal(found.intrinsics, found.focal_source, notes), found.inverse_depth.shape
    flat = flat_geometry(len(found.world_to_camera), (height, width), camera)
    return replace(flat, reference=found.reference, source=found.source)
