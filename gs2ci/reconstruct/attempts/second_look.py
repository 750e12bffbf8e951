"""A doubtful first path, estimated once more from the views of a fit.

    first look ─► fits ─► second look ─► fits ─► the better of both

With many masks or little light, decoded views are poor, and so is a path estimated from them. The views of a fit,
refined by its residual, are far better: points can be tracked in them that are lost in the decode.

Here: when to look again, and the second estimate. Not here: the fits (`fits`), the choice between them (`choice`).
"""

from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.choose import is_doubtful
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.settings import Settings


def is_wanted(first: Geometry, settings: GeometrySettings) -> bool:
    """Tell whether a first geometry is worth a second look: it has a path, which nothing confirms."""
    return first.verdict == "full" and is_doubtful(first, settings.criteria)


def second_look(
    first: FirstLook, views: F32, lens: Lens | None, settings: Settings, progress: Progress
) -> FirstLook | None:
    """Estimate the geometry again from fitted views; None if they show no path.

    Such views show a scene that was fitted along the first path, so agreement between halves of their tracks proves
    nothing. The doubts about the first path are therefore kept.

    Args:
        first: The first look, from the decoded views.
        views: Those of a fit, refined, [N, H, W, C].
        lens: Through which the measurement was taken, unless it is a pinhole.
        settings: Of the stages before a fit.
        progress: Receives every step.
    """
    before = first.geometry
    progress.say("The camera path is doubtful: it is estimated again from the views of the fit.")
    found = from_tracks(Request.of(first.holdout.seen, views, settings.geometry, lens), progress)
    if found.verdict != "full":
        return None
    if _covariance(found.inverse_depth, before.inverse_depth) < 0:
        # The order of depth was settled before; tracks alone may not reverse it.
        found = found.reverse or reversed_geometry(found)
    geometry = replace(
        found,
        order_errors=before.order_errors,
        reverse=None,
        source=before.source,
        path_error_expected=before.path_error_expected,
        notes=(*before.notes, finding(Code.PATH_FOUND_AGAIN)),
    )
    return replace(first, geometry=geometry)


def _covariance(one: F32, other: F32) -> float:
    return float(np.mean((one - one.mean()) * (other - other.mean())))
