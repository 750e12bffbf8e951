"""A doubtful path, or one that was not found, estimated once more from the views of a fit.

    first look ─► half a fit ─► second look ─► fits ─► the better of both

With many masks or little light, decoded views are poor, and so is a path estimated from them. The views of a fit,
refined by its residual, are far better: points can be tracked in them that are lost in the decode. A parallax of two
pixels drowns in the decode's errors, and is clear in the views of a scene that was fitted without any, once they are
refined and polished by patches.

Here: when to look again, and the second estimate. Not here: the fits (`fitting`), which go on (`race`).
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.choose import is_doubtful
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings
from gs2ci.reconstruct.geometry.path.validity import halves_agree
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.reversal import turned
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.settings import Settings

# In polished views, which err by 0.05 to 0.2 px along tracks (decoded views by 0.2 to 0.8): the least parallax that
# counts as one, and how many times larger errors must be under pure rotations than along the path. Small motions had
# factors from 1.6 to 3.2, cameras that turned or stood still up to 1.55
# (docs/decisions/path-from-fits.md).
_PARALLAX_PX: Final = 0.05
_UNEXPLAINED: Final = 1.6


def is_wanted(first: Geometry, settings: GeometrySettings) -> bool:
    """Tell whether a first geometry is worth a second look: it has a path that nothing confirms, or none."""
    return first.lacks_path or (first.has_path and is_doubtful(first, settings.criteria))


def second_look(
    first: FirstLook, views: F32, lens: Lens | None, settings: Settings, progress: Progress
) -> FirstLook | None:
    """Estimate the geometry again from fitted views; None if they show no path.

    Such views show a scene that was fitted along the first path, so agreement between halves of their tracks proves
    nothing. The doubts about the first path are therefore kept. A scene that was fitted without a path has no parallax
    of its own: what its refined views show of it comes from the measurement.

    Args:
        first: The first look, from the decoded views.
        views: Those of a fit, refined, [N, H, W, C].
        lens: Through which the measurement was taken, unless it is a pinhole.
        settings: Of the stages before a fit.
        progress: Receives every step.
    """
    before = first.geometry
    if before.lacks_path:
        return _found_in_fit(first, views, lens, settings, progress)
    progress.say("The camera path is doubtful: it is estimated again from the views of the fit.")
    found = from_tracks(Request.of(first.holdout.seen, views, settings.geometry, lens), progress)
    if not found.has_path:
        return None
    one, other = found.inverse_depth, before.inverse_depth
    if np.mean((one - one.mean()) * (other - other.mean())) < 0:
        # The order of depth was settled before; tracks alone may not reverse it.
        found = turned(found)
    geometry = replace(
        found,
        order_errors=before.order_errors,
        other_order=None,
        source=before.source,
        path_error_expected=before.path_error_expected,
        notes=(*before.notes, finding(Code.PATH_FOUND_AGAIN)),
    )
    return replace(first, geometry=geometry)


def _found_in_fit(
    first: FirstLook, views: F32, lens: Lens | None, settings: Settings, progress: Progress
) -> FirstLook | None:
    progress.say("No camera path was found: it is sought in the views of the fit.")
    polished = patch_decode_from(first.holdout.seen, views, PatchSettings.polish_sparsely())
    # Tracks in polished views err little and alike: their preference for an order of depth proves nothing, so that its
    # order stays open; and halves of them may agree on a path that is none, so that this is asked for but not enough.
    criteria = replace(
        settings.geometry.criteria,
        parallax_px=_PARALLAX_PX,
        unexplained=_UNEXPLAINED,
        agreement=0.0,
        order_errors=math.inf,
    )
    seeking = replace(settings.geometry, criteria=criteria)
    found = from_tracks(Request.of(first.holdout.seen, polished, seeking, lens), progress)
    if not found.has_path or not halves_agree(found.path_error_expected, settings.geometry.criteria):
        return None
    note = finding(Code.PATH_FOUND_IN_FIT, parallax_px=found.parallax_px)
    return replace(first, geometry=replace(found, order_errors=None, notes=(*found.notes, note)))
