"""Views far apart, whose path tracks do not find or find roughly: features of all pairs matched again.

    fits along a path that turns far, or no better than a decode ─► decode by similar patches
    ─► features in tilted pictures ─► path

Views 15° apart, in any order, share hardly a corner that can be tracked, and in views decoded by GAP-TV few features
match. Similar patches, sought within each view and its neighbours, need no path, and decode such views 3 to 6 dB
better (docs/decisions/wide-baseline.md).

Around an object, tracks follow points from one view to the next, and lose them before it has been turned by 20°: errors
add up along the path, and halves of the tracks share them (docs/decisions/wide-baseline.md).

Here: the look that results. Not here: the features and the scene that grows from them
(`geometry.sources.wide`), the first look itself (`first_look`), the fits (`fitting`).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres, path_extent
from gs2ci.core.errors import GeometryError
from gs2ci.core.progress import Progress, said
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.choose import explains_more_than_rest
from gs2ci.reconstruct.geometry.depth.view_depths import turns_far
from gs2ci.reconstruct.geometry.evidence import carried_views
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.halves import squared_distance
from gs2ci.reconstruct.geometry.path.validity import halves_agree
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.wide import wide_motion
from gs2ci.reconstruct.measurement.brightness import estimate
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.settings import Settings

# Paths whose centres are apart by no more than this share of their extent, and whose turns by no more than this angle,
# are the same. Centres alone do not tell a nearly straight path from that of the reversed order of depth.
_SAME_PATH: Final = 0.01
_SAME_TURN_DEG: Final = 3.0


def look_far_apart(
    longer: FirstLook,
    lens: Lens | None,
    settings: Settings,
    progress: Progress,
    lap: Callable[[str], None],
    path: F64,
) -> FirstLook | None:
    """Estimate the path from features matched between all pairs of views of a longer decode.

    The brightness of the views along it is only reported.

    Args:
        longer: A first look with such views, whose path is wrong, or that has none.
        lens: Through which it was taken, unless it is a pinhole.
        settings: Of all stages.
        progress: Receives every stage and step.
        lap: Called with a stage's name when it ends.
        path: Of the best fit so far, [N, 4, 4].

    Returns:
        The look along the path found; None if not every view joins, or if the path explains no more than a camera at
        rest and does not turn far or parts of the matches give others, or if it is the path of the best fit.
    """
    progress.say("The views may lie far apart: features are matched again in a decode by similar patches.")
    request = Request.of(longer.holdout.seen, longer.decoded, settings.geometry, lens)
    try:
        geometry = wide_motion(request, longer.geometry, tilted=True)
    except GeometryError as error:
        progress.say(error.problem)
        lap("geometry")
        return None
    # Around an object, 80° from the first view to the last, views warped along the right path explained less than a
    # camera at rest: there it is enough that halves of the matches agree. For a camera that did not move they
    # once agreed to 5 %, along a path of 2 % of the depth.
    agreed = halves_agree(geometry.path_error_expected, settings.geometry.criteria)
    turned = agreed and turns_far(geometry.world_to_camera)
    found = geometry.has_path and (turned or explains_more_than_rest(request, geometry))
    if not found or _is_path(geometry, path):
        lap("geometry")
        return None
    light = estimate(longer.holdout, carried_views(request.views, geometry, lens))
    lap("geometry")
    said(geometry.notes, progress)
    return replace(longer, geometry=geometry, brightness=replace(longer.brightness, first=light))


def _is_path(geometry: Geometry, path: F64) -> bool:
    """Tell whether a path, [N, 4, 4], is that of a geometry, as far as it is known."""
    centres = camera_centres(geometry.world_to_camera)
    extent = path_extent(geometry.world_to_camera)
    apart = squared_distance(camera_centres(path), centres) ** 0.5
    one, other = (_turns(poses, geometry.reference) for poses in (geometry.world_to_camera, path))
    turned = float((one * other.inv()).magnitude().max())
    near = apart <= max(geometry.path_error_expected or 0.0, _SAME_PATH) * extent
    return bool(near and turned <= math.radians(_SAME_TURN_DEG))


def _turns(world_to_camera: F64, reference: int) -> Rotation:
    """Return the turns of views, [N, 4, 4], against the reference view, in its axes."""
    turns = Rotation.from_matrix(world_to_camera[:, :3, :3])
    return turns * turns[reference].inv()
