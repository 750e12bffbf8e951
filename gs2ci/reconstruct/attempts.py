"""A uniform motion against a camera at rest: which of them a fit makes more of.

Where no points can be tracked, a uniform motion is the path that explains the measurement best. Where little shows but
a period or a gradient, any motion does as well, and a fit that begins at rest, before a plane, ends several dB better.
Short fits tell. Here: that comparison. Not here: the motion (`geometry/direct.py`), a fit (`fit/coarse.py`), the order
of depth along a path (`order`). For `gs2ci.reconstruct.pipeline`.
"""

import math
from dataclasses import replace
from typing import Final

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.geometry.direct import at_rest
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry
from gs2ci.reconstruct.order import ShortFit

# So many short fits of each, with seeds of their own: one may be lucky.
_TRIES: Final = 2


def moving_or_at_rest(geometry: Geometry, fit_briefly: ShortFit, progress: Progress) -> Geometry:
    """Take a uniform motion, or a camera at rest where short fits from there leave less of the measurement.

    Args:
        geometry: A uniform motion that no tracks bear out.
        fit_briefly: Called for either.
        progress: Told of what is done.

    Returns:
        Either, with a note of how much each left.
    """
    progress.say("No points bear the motion out: a fit along it and one from rest are tried.")
    rest = at_rest(geometry)
    moving_left, rest_left = (
        sum(fit_briefly(one, number) for number in range(_TRIES)) / _TRIES for one in (geometry, rest)
    )
    ranked: tuple[Finding, ...] = ()
    if math.isfinite(moving_left) and math.isfinite(rest_left):
        ranked = (finding(Code.ATTEMPTS_RANKED, uniform=moving_left**0.5, rest=rest_left**0.5),)
    if moving_left <= rest_left:
        return replace(geometry, notes=(*geometry.notes, *ranked))
    kept = tuple(note for note in rest.notes if note.code != Code.UNIFORM_MOTION)
    return replace(rest, notes=(*kept, *ranked, PLANE_NOTE))
