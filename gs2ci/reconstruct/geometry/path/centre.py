"""A principal point that may move with the camera, recognised by a turn exactly proportional to the travel.

Sensors of a light field's cameras may be shifted so that a plane inside the scene stays at the same pixels: the cameras
are parallel, and their principal point moves by s px from view to view. No camera model here describes that. A pinhole
shows nearly the same if it turns by s / f with each step about a point of that plane; the two differ by s u v at (u, v)
in a view, in units of the focal length: a quarter of a pixel in the corners of a field of view of 20 degrees with s of
8 px. A fit cannot tell the two apart then, but such a turn can be recognised: a hand or a stage wobbles, and does not
turn in proportion to its travel about a point between near and far. The recognised shift may be too small by the
parallax of the farthest point, since scenes and shifts that differ by it look alike. Here: that turn, and when it is
reported. Not here: the path (`motion`, `fit/optimiser/poses.py`); shifting the views back, which is left to the user.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64, Size
from gs2ci.core.cameras import relative_to
from gs2ci.core.findings import Code, Findings, finding

# With fewer views any turn is proportional to any travel.
_LEAST_VIEWS: Final = 4
# Least share of the turns about axes across the line of sight that travel explains; and the largest residual, px, root
# mean square. Wobbles, and the errors of paths that only travelled, had residuals of 0.25 px and more.
_IN_STEP: Final = 0.99
_WOBBLE_PX: Final = 0.15
# The point about which the cameras turn lies between these quantiles of the scene's inverse depth.
_INSIDE: Final = (0.05, 0.95)
# The least shift between neighbouring views that is reported, px.
_LEAST_SHIFT_PX: Final = 0.25
# If the two models differ by more than this in the corners of views, the fit tells them apart: the cameras did turn.
_TOLD_APART_PX: Final = 1.0
# Cameras whose principal point moves are shifted within a common plane. A camera that mostly goes forwards drifts
# aside, and turns, along one straight line, too.
_MOST_AHEAD: Final = 0.5


@dataclass(frozen=True)
class Turning:
    """How cameras turn as they travel.

    Args:
        shift_px: Shift of a view's picture against its neighbour's by the turn alone, along the travel.
        inverse_depth: Of the point about which they turn; below 0 if they turn away.
        in_step: Share of the turns' squares that the travel explains.
        wobble_px: The rest of the turns, root mean square.
        apart_px: Largest difference, in a corner, from views whose principal point moves instead.
        ahead: Travel along the line of sight relative to travel across it, each root mean square.
    """

    shift_px: float
    inverse_depth: float
    in_step: float
    wobble_px: float
    apart_px: float
    ahead: float


def turning(world_to_camera: F64, intrinsics: F64, size: Size, reference: int) -> Turning | None:
    """Relate turns across the line of sight to travel across it.

    Args:
        world_to_camera: Poses, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        reference: The view relative to which both are measured.

    Returns:
        None if cameras do not travel sideways or do not turn at all.
    """
    relative = relative_to(world_to_camera, reference)
    turns = Rotation.from_matrix(relative[:, :3, :3]).as_rotvec()
    travel, towards = relative[:, :2, 3], np.stack([-turns[:, 1], turns[:, 0]], axis=1)
    aside, turned = float((travel**2).sum()), float((towards**2).sum())
    if aside == 0 or turned == 0:
        return None
    focal = float(np.sqrt(intrinsics[0, 0] * intrinsics[1, 1]))
    inverse_depth = float((towards * travel).sum()) / aside
    rest = float(((towards - inverse_depth * travel) ** 2).sum())
    step = float(np.linalg.norm(np.diff(travel, axis=0), axis=1).mean()) if len(travel) > 1 else 0.0
    corner = [max(centre, side - centre) for centre, side in zip(intrinsics[:2, 2], size[::-1], strict=True)]
    farthest = float(np.linalg.norm(travel, axis=1).max())
    return Turning(
        shift_px=focal * inverse_depth * step,
        inverse_depth=inverse_depth,
        in_step=1 - rest / turned,
        wobble_px=focal * float(np.sqrt(rest / len(travel))),
        apart_px=focal * abs(inverse_depth) * farthest * float(np.prod(np.array(corner) / focal)),
        ahead=float(np.sqrt((relative[:, 2, 3] ** 2).sum() / aside)),
    )


def doubts_about_centre(world_to_camera: F64, intrinsics: F64, inverse_depth: F32, reference: int) -> Findings:
    """Report that a principal point which moves with the camera would explain its turning as well; or nothing.

    Args:
        world_to_camera: Estimated poses, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3].
        inverse_depth: Of the reference view, [H, W]; 0 at pixels where it is not known.
        reference: That view.
    """
    known = inverse_depth[inverse_depth > 0]
    if len(world_to_camera) < _LEAST_VIEWS or not known.size:
        return ()
    size = (inverse_depth.shape[0], inverse_depth.shape[1])
    found = turning(world_to_camera, intrinsics, size, reference)
    if found is None or found.in_step < _IN_STEP or found.wobble_px > _WOBBLE_PX or found.ahead > _MOST_AHEAD:
        return ()
    far, near = np.quantile(known, _INSIDE)
    inside = far < found.inverse_depth < near
    if not inside or found.shift_px < _LEAST_SHIFT_PX or found.apart_px > _TOLD_APART_PX:
        return ()
    return (finding(Code.CENTRE_MAY_MOVE, shift_px=found.shift_px, apart_px=found.apart_px),)
