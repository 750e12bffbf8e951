"""Geometry priors by name, and `auto`, which compares several and chooses one.

Here: the names, and `auto`. Not here: the sources themselves.

Where tracks show no path, or a doubtful one, the motion that explains displacements of blocks of the measurement takes
their place, if it is expected to err less (docs/decisions/sources-of-geometry.md). `auto` uses every source that this
shot has on this machine: the stage if it reported poses, the tracks, VGGT if the user has added it. The measurement
chooses (`evidence`) among those that the tracks do not contradict: a source is replaced by a later one only if the
later one's residual is clearly smaller. A stage's poses that tracks bear out stand, and no other source is asked. The
stage comes first, since blur and noise of the picture do not affect it, and since it distinguishes a shift from a pan;
a picture cannot do so if the parallax is as small as the tracks' errors. Wrong poses of a stage are found by the
measurement (`python -m tests.benchmarks stage_poses`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, TypeGuard

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres, relative_to
from gs2ci.core.errors import Gs2ciError, InputError
from gs2ci.core.findings import Code, finding
from gs2ci.core.plugins import brought, names
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.geometry.initialise import Geometry, OtherOrder
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.path.telemetry import poses_of_stage
from gs2ci.reconstruct.geometry.path.validity import Criteria, doubts_about_path
from gs2ci.reconstruct.geometry.prior import GeometryPrior, Request, Source, from_tracks
from gs2ci.reconstruct.geometry.reversal import turned
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.geometry.sources.displaced import displaced_motion, say_how_found
from gs2ci.reconstruct.geometry.sources.sources import (
    from_displacements,
    from_file,
    from_rest,
    from_stage,
    from_wide,
)
from gs2ci.reconstruct.learned.onnx_models import known_model
from gs2ci.reconstruct.paper_parts import PaperPart, paper_part

GEOMETRY_NAMES: Final = ("tracks", "stage", "wide", "displacements", "rest", "auto", "vggt")
GEOMETRY_GROUP: Final = "gs2ci.geometry"
_AUTO: Final = "auto"
_FILE: Final = "file:"
# A later source must reduce the residual at least to this share; smaller differences are noise of the decode.
_CLEARLY: Final = 0.99
# Two maps of inverse depth have opposite orders of depth if they correlate by less than minus this; maps of noise do
# not reach it.
_CLEARLY_REVERSED: Final = 0.3
# Cosine of 45 degrees: beyond it, a stage reports another direction of travel than tracks show, in either order.
_SAME_LINE: Final = 0.7


def load_geometry_prior(name: str) -> GeometryPrior:
    """Load a geometry prior.

    Args:
        name: "tracks"; "stage"; "wide"; "displacements"; "rest"; "auto"; "file:PATH" (a COLMAP model's
            folder or a transforms.json); "vggt", the model added under that name; "vggt:FILE"; "vggt-or-tracks", the
            tracks if no model has been added; or the name of a plug-in, which is called for its prior.

    Raises:
        InputError: No such name, no such file, or a model file that cannot be used.
        StorageError: The list of added models cannot be read.
    """
    by_name: dict[str, Callable[[Request, Progress], Geometry]] = {
        PathSource.TRACKS: from_tracks,
        PathSource.STAGE: from_stage,
        PathSource.MATCHES: from_wide,
        PathSource.DISPLACEMENTS: from_displacements,
        PathSource.REST: from_rest,
        _AUTO: auto,
    }
    if name in by_name:
        return Source(name, by_name[name])
    if name.startswith(_FILE):
        path = Path(name.removeprefix(_FILE))
        if not path.exists():
            raise InputError(f"no camera file {path}", allowed="a COLMAP model's folder or a transforms.json")
        return Source(PathSource.FILE, partial(from_file, path))
    if name.startswith(PathSource.VGGT):
        of_the_paper: GeometryPrior | None = paper_part(PaperPart.VGGT)(name)
        if of_the_paper is not None:
            return of_the_paper
    prior = brought(GEOMETRY_GROUP, name)
    if prior is None:
        own = ", ".join(GEOMETRY_NAMES[:-1])
        more = ", ".join(("file:PATH", *names(GEOMETRY_GROUP)))
        raise InputError(f"geometry {name!r}", allowed=f"{own}, {more}, vggt, vggt:FILE or vggt-or-tracks")
    return prior


@dataclass(frozen=True)
class _Answer:
    """The result of one source.

    Args:
        geometry: Its geometry; None if it failed.
        left: Its residual of the measurement (`unexplained`); infinite if it failed.
        said: The same in words.
    """

    geometry: Geometry | None
    left: float
    said: str


def auto(request: Request, progress: Progress) -> Geometry:
    """Use all available sources, and let the measurement choose; see `GeometryPrior`."""
    staged = request.shot.telemetry_world_to_camera is not None
    answers = [_asked(request, PathSource.STAGE, progress)] if staged else []
    stage = answers[0].geometry if staged else None
    if _is_borne_out(stage) and stage.parallax_px >= request.settings.criteria.parallax_px:
        # It stands whatever path the tracks would give, which takes longer to find than all else of a draft's look.
        note = finding(Code.SOURCE_CHOSEN, source=PathSource.STAGE, answers=answers[0].said)
        return replace(stage, notes=(*said((note,), progress), *stage.notes))
    tracks = _tracks_or_displacements(request, from_tracks(request, progress))
    say_how_found(tracks, progress)
    learned = [PathSource.VGGT] if known_model("vggt") is not None else []
    if not staged and not learned:
        return tracks
    answers += [_judged(request, tracks.source, tracks), *(_asked(request, name, progress) for name in learned)]
    standing = _standing(answers)
    chosen = tracks if standing is None else standing
    if chosen.source == tracks.source:
        chosen = _in_the_order_of(stage, chosen)
    answered = ", ".join(answer.said for answer in answers)
    notes = [finding(Code.SOURCE_CHOSEN, source=chosen.source, answers=answered)]
    if staged and standing is not None and standing.source != PathSource.STAGE:
        refused = stage is None or not stage.has_path
        lies = refused and _lies_in_its_sign(request)
        notes.append(finding(Code.STAGE_SIGN_CONTRADICTED if lies else Code.STAGE_NOT_TAKEN))
    elif chosen.source == PathSource.STAGE and tracks.verdict == Verdict.STATIC:
        notes.append(finding(Code.STAGE_MOTION_UNSEEN))
    said(notes, progress)
    return replace(chosen, notes=(*notes, *chosen.notes))


def _tracks_or_displacements(request: Request, tracks: Geometry) -> Geometry:
    """Return the motion from displacements of blocks, if tracks show none, or one that is expected to err more.

    Tracks are measured in decoded views: small motions drown in their errors, and behind one displaced pattern they
    follow what the decode leaves of it.
    """
    if tracks.has_path and not is_doubtful(tracks, request.settings.criteria):
        return tracks
    if LeftOut.DISPLACEMENTS in request.settings.left_out:
        return tracks
    displaced = displaced_motion(request, tracks)
    if not displaced.has_path:
        return tracks
    if not tracks.has_path:
        return displaced
    expected = tracks.path_error_expected
    # A path from displacements always has an expected error.
    if expected is not None and (displaced.path_error_expected or 0.0) >= expected:
        return tracks
    if (tracks.order_errors or 0.0) <= (displaced.order_errors or 0.0):
        return displaced
    return replace(_with_order_of(tracks, displaced), order_errors=tracks.order_errors)


def _in_the_order_of(stage: Geometry | None, chosen: Geometry) -> Geometry:
    """Return the tracks' path in the stage's order of depth, if the stage settles one.

    A stage whose positions are too inaccurate to be used still reports the right direction of travel; one that reports
    another axis than the camera moved along does not, and says nothing of the order.
    """
    if stage is None or not stage.order_given or not chosen.has_path:
        return chosen
    if abs(float(_line_of(stage) @ _line_of(chosen))) < _SAME_LINE:
        return chosen
    return replace(_with_order_of(stage, chosen), order_given=True, other_order=None)


def _line_of(geometry: Geometry) -> F64:
    """Return the direction, [3], of either sign, along which a path is longest, as its reference camera sees it."""
    centres = camera_centres(geometry.world_to_camera)
    return np.linalg.svd(centres - centres.mean(axis=0))[2][0]


def _with_order_of(other: Geometry, chosen: Geometry) -> Geometry:
    """Return a geometry, or its reverse if its order of depth is opposite to that of another."""
    with np.errstate(invalid="ignore"):
        alike = float(np.corrcoef(other.inverse_depth.ravel(), chosen.inverse_depth.ravel())[0, 1])
    if not alike < -_CLEARLY_REVERSED:  # not a number for a map of one depth, which has no order
        return chosen
    return replace(turned(chosen), other_order=OtherOrder.of(chosen))


def _lies_in_its_sign(request: Request) -> bool:
    """Tell whether a stage whose poses are rejected would be confirmed with its direction of travel reversed."""
    poses = poses_of_stage(request.shot)
    back = relative_to(poses, len(poses) // 2)
    back[:, :3, 3] *= -1
    shot = replace(request.shot, telemetry_world_to_camera=back)
    back_again = _asked(replace(request, shot=shot), PathSource.STAGE, Silent()).geometry
    return back_again is not None and back_again.has_path


def is_doubtful(geometry: Geometry, criteria: Criteria) -> bool:
    """Tell whether nothing confirms a path: there is none, or halves of the tracks disagree."""
    doubts = doubts_about_path(geometry.path_error_expected, criteria)
    return geometry.verdict == Verdict.UNSUPPORTED or bool(doubts)


def _standing(answers: Sequence[_Answer]) -> Geometry | None:
    """Return the geometry that is preferred to all others; None if no source has one that tracks support.

    Given poses that tracks bear out stand: with the depths of a poor decode, exact ones may leave several percent more
    than a path that follows its errors.
    """
    standing, least = None, float("inf")
    for answer in answers:
        supported = answer.geometry is not None and answer.geometry.verdict != Verdict.UNSUPPORTED
        if supported and (standing is None or answer.left < _CLEARLY * least):
            standing, least = answer.geometry, answer.left
        if _is_borne_out(standing):
            break
    return standing


def _is_borne_out(given: Geometry | None) -> TypeGuard[Geometry]:
    """Tell whether tracks bear out poses that were given."""
    errors = None if given is None or not given.tracks else given.pose_errors
    return errors is not None and not errors.contradicted


def explains_more_than_rest(request: Request, found: Geometry) -> bool:
    """Tell whether a geometry explains the measurement clearly better than a camera at rest before a plane."""
    left, at_most = (unexplained(request.shot, request.views, one, request.lens) for one in (found, at_rest(found)))
    return left < _CLEARLY * at_most


def _asked(request: Request, name: str, progress: Progress) -> _Answer:
    try:
        return _judged(request, name, load_geometry_prior(name)(request, progress))
    except Gs2ciError as error:
        return _Answer(None, float("inf"), f"the {name} failed ({error.problem})")


def _judged(request: Request, name: str, geometry: Geometry) -> _Answer:
    left = unexplained(request.shot, request.views, geometry, request.lens)
    verdict = "" if geometry.has_path else f" ({geometry.verdict.replace('_', ' ')})"
    return _Answer(geometry, left, f"{left:.4f} by the {name}{verdict}")
