"""Views far apart, whose path tracks do not find or find roughly: features of all pairs matched again.

    first look (few views join one scene) ─► decode by similar patches ─► features in tilted pictures ─► path
    fits along a path that turns far ─► features in their views ─► path

Views 15° apart, in any order, share hardly a corner that can be tracked, and in views decoded by GAP-TV few features
match. Similar patches, sought within each view and its neighbours, need no path, and decode such views 3 to 6 dB
better (docs/decisions/0115-matched-again-in-a-longer-decode.md).

Around an object, tracks follow points from one view to the next, and are lost before it has been turned by 20°: errors
add up along the path, without a doubt that halves of the tracks would show. Features match across 20° in the views of a
fit (docs/decisions/0116-scenes-grown-from-many-pairs.md).

Here: when to match again, and the look that results. Not here: the features and the scene that grows from them
(`geometry.wide`), the first look itself (`first_look`), the fits (`attempts`).
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import camera_centres
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.decode.by_name import decode_by_name
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.choose import explains_more_than_rest
from gs2ci.reconstruct.geometry.evidence import carried_views
from gs2ci.reconstruct.geometry.halves import squared_distance
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources import matched_motion
from gs2ci.reconstruct.measurement.brightness import Brightness, estimate
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.settings import Settings

# Patches of decoded views can be tracked over about so large a turn.
_FAR_DEG: Final = 15.0
# Paths whose centres are apart by no more than this share of their extent are the same.
_SAME_PATH: Final = 0.01


def joins_in_part(first: FirstLook) -> bool:
    """Tell whether features joined some views of a first look to a scene, and no source found a path for all."""
    return any(note.code == Code.VIEWS_JOIN_IN_PART for note in first.geometry.notes)


def turns_far(world_to_camera: F64) -> bool:
    """Tell whether some views of a path, [N, 4, 4], are turned so far against others that tracks between them end."""
    turns = Rotation.from_matrix(world_to_camera[:, :3, :3])
    return any(float((turn * turns.inv()).magnitude().max()) >= math.radians(_FAR_DEG) for turn in turns)


def look_around(
    look: FirstLook, path: F64, views: F32, lens: Lens | None, settings: Settings, progress: Progress
) -> FirstLook | None:
    """Estimate a path that turns far again, from features matched between all pairs of a fit's views.

    Args:
        look: Where the fit started.
        path: Where it ended, [N, 4, 4].
        views: Of the fit, refined, [N, H, W, C].
        lens: Through which the measurement was taken, unless it is a pinhole.
        settings: Of all stages.
        progress: Receives what is done.

    Returns:
        The look along the path found; None if not every view joins, if parts of the matches give other paths, or if it
        is the path of the fit.
    """
    progress.say("The camera turned far: its path is estimated again from features of all pairs of the fit's views.")
    found = matched_motion(Request.of(look.holdout.seen, views, settings.geometry, lens), look.geometry)
    if found.verdict != "full" or not _agrees(found, settings):
        return None
    centres = camera_centres(found.world_to_camera)
    extent = float(np.linalg.norm(np.ptp(centres, axis=0)))
    apart = squared_distance(camera_centres(path), centres) ** 0.5
    if apart <= max(found.path_error_expected or 0.0, _SAME_PATH) * extent:
        return None
    return replace(look, geometry=replace(found, notes=(*found.notes, finding(Code.PATH_FOUND_AGAIN))))


def look_far_apart(
    first: FirstLook,
    holdout: Holdout,
    lens: Lens | None,
    settings: Settings,
    progress: Progress,
    lap: Callable[[str], None],
) -> FirstLook | None:
    """Decode longer, and estimate the path from features matched between all pairs of views.

    Weights that were corrected along a path that is wrong are forgotten; the brightness of the views is only reported.

    Args:
        first: A first look whose path is wrong, or that has none.
        holdout: The measurement with its weights as given, and its held-out pixels.
        lens: Through which it was taken, unless it is a pinhole.
        settings: Of all stages.
        progress: Receives every stage and step.
        lap: Called with a stage's name when it ends.

    Returns:
        The first look with the longer decode, along the path found; None if not every view joins, or if parts of the
        matches give other paths and the path explains no more than a camera at rest, or if the settings allow no
        longer decode.
    """
    if settings.long_decode is None:
        return None
    progress.say("The views may lie far apart: features are matched again in a decode by similar patches.")
    if first.holdout is not holdout:
        decoded = decode_by_name(holdout.seen, settings.first_look, settings.decode, progress)
        brightness = Brightness(first.brightness.first, None, first.brightness.as_seen)
        first = replace(first, holdout=holdout, decoded=decoded, brightness=brightness)
    longer = first if first.decoder == "patches" else first.decoded_longer(settings.long_decode.sparse, progress)
    lap("decode")
    request = Request.of(holdout.seen, longer.decoded, settings.geometry, lens)
    geometry = matched_motion(request, first.geometry, tilted=True)
    if geometry.verdict != "full" or not (_agrees(geometry, settings) or explains_more_than_rest(request, geometry)):
        lap("geometry")
        return None
    light = estimate(holdout, carried_views(request.views, geometry, lens))
    lap("geometry")
    for note in geometry.notes:
        progress.say(note.sentence)
    return replace(longer, geometry=geometry, brightness=replace(longer.brightness, first=light))


def _agrees(geometry: Geometry, settings: Settings) -> bool:
    """Tell whether parts of the matches give the same path.

    Where they do, views that are warped along it need not explain the measurement: around an object, 80° from the first
    view to the last, those of the right path explained less of it than a camera at rest.
    """
    error = geometry.path_error_expected
    return error is not None and error <= settings.geometry.criteria.agreement
