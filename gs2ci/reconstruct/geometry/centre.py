"""A principal point that may move with the camera, told by a turn that keeps exact pace with the travel.

Sensors of a light field's cameras may be shifted so that a plane inside the scene stays put: parallel cameras, whose
principal point moves by s px for each view. No camera model here allows for that. A pinhole shows nearly the same if it
turns by s / f with each step about a point of that plane; the two differ by s u v at the place (u, v) of a view, in
units of the focal length: a quarter of a pixel in the corners of a field of view of 20 degrees with s of 8 px. A fit of
both cannot tell them there, but a turn of that kind can be named: a hand or a stage wobbles, and does not turn in
step with its travel about a point that lies between near and far. Of the shift, the parallax of what is farthest may be
missing: scenes and shifts that differ by that look alike. Here: that turn, and when it is worth a word. Not
here: the path (`motion`, `fit/poses.py`), shifting the views back, which is the user's to do.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Finding, finding

# With fewer views any turn is in step with any travel.
_LEAST_VIEWS: Final = 4
# What travel explains of the turns about axes across the line of sight, at least; and what it may leave, px, root mean
# square. Wobbles, and the errors of paths that only travelled, left 0.25 px and more.
_IN_STEP: Final = 0.99
_WOBBLE_PX: Final = 0.15
# Of the scene's inverse depths: the point about which the cameras turn lies between these quantiles.
_INSIDE: Final = (0.05, 0.95)
# A shift between neighbouring views that is worth a word, px.
_LEAST_SHIFT_PX: Final = 0.25
# Views that differ by more than this in their corners are told apart by the fit: the cameras did turn.
_TOLD_APART_PX: Final = 1.0


@dataclass(frozen=True)
class Turning:
    """How cameras turn as they travel.

    Args:
        shift_px: By which a view's picture shifts against its neighbour's for the turn alone, along the travel.
        inverse_depth: Of the point about which they turn; below 0 where they turn away.
        in_step: Share of the turns' squares that the travel explains.
        wobble_px: What it leaves of them, root mean square.
        apart_px: Largest difference in a picture's corner from views whose principal point moves instead.
    """

    shift_px: float
    inverse_depth: float
    in_step: float
    wobble_px: float
    apart_px: float


def turning(world_to_camera: F64, intrinsics: F64, size: tuple[int, int], reference: int) -> Turning | None:
    """Relate turns across the line of sight to travel across it.

    Args:
        world_to_camera: Poses, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        reference: The view that both are counted from.

    Returns:
        None where cameras do not travel aside or do not turn at all.
    """
    relative = world_to_camera @ np.linalg.inv(world_to_camera[reference])
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
    )


def doubts_about_centre(
    world_to_camera: F64, intrinsics: F64, inverse_depth: F32, reference: int
) -> tuple[Finding, ...]:
    """Say that a principal point which moves with the camera would show what its turning shows; or nothing.

    Args:
        world_to_camera: Poses that nobody told, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3].
        inverse_depth: Of the reference view, [H, W]; 0 where it is not known.
        reference: That view.
    """
    known = inverse_depth[inverse_depth > 0]
    if len(world_to_camera) < _LEAST_VIEWS or not known.size:
        return ()
    size = (inverse_depth.shape[0], inverse_depth.shape[1])
    found = turning(world_to_camera, intrinsics, size, reference)
    if found is None or found.in_step < _IN_STEP or found.wobble_px > _WOBBLE_PX:
        return ()
    far, near = np.quantile(known, _INSIDE)
    inside = far < found.inverse_depth < near
    if not inside or found.shift_px < _LEAST_SHIFT_PX or found.apart_px > _TOLD_APART_PX:
        return ()
    return (finding(Code.CENTRE_MAY_MOVE, shift_px=found.shift_px, apart_px=found.apart_px),)
