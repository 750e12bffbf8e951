"""VGGT's prediction as a geometry: the checks that decide how much of it is used (paper, section III-B, supplement I).

    for the views in order, then, with more tracks, in three other orders:
        after bundle adjustment: every view registered, tracks explained and spread, focal length stable    ─► taken
        before it: most views registered, tracks explained and spread                                       ─► taken
    the model's own depth and cameras, if their focal length, their depths and the few tracks agree         ─► taken
    otherwise the tracks alone (`prior.find_geometry`)

Here: that order, and its criteria beyond those of `validity`, the same for all scenes; no step sees the truth. Not
here: the model (`vggt`), the adjustment (`bundle`), tracks and depth (`initialise`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np

from gs2ci.core.arrays import F32, F64, Size
from gs2ci.core.cameras import camera_centres, pinhole, relative_to
from gs2ci.core.errors import GeometryError, NumericsError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise, usable_tracks
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.path.adjustment_kernels import INVERSE_DEPTH_RANGE
from gs2ci.reconstruct.geometry.path.bundle import adjust_bundle
from gs2ci.reconstruct.geometry.path.focal import Focal, default_focal, estimate_focal, focal_from_view_angle
from gs2ci.reconstruct.geometry.path.motion import predict_positions
from gs2ci.reconstruct.geometry.path.rotations import fit_rotations
from gs2ci.reconstruct.geometry.path.telemetry import place_points
from gs2ci.reconstruct.geometry.path.validity import classify_motion, doubts_about_tracks, supported_views
from gs2ci.reconstruct.geometry.prior import GeometryPrior, Request, Source, from_tracks
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks
from gs2ci.reconstruct.learned.onnx_models import find_model, known_model
from gs2ci.reconstruct.learned.vggt import Prediction, Vggt

_FILE: Final = "vggt:"
_OR_TRACKS: Final = "vggt-or-tracks"
Step = Literal["after adjustment", "before adjustment"]


@dataclass(frozen=True)
class PredictionCriteria:
    """What a prediction must satisfy beyond the criteria of tracks and motion (`validity.Criteria`).

    Args:
        registered: Least share of the views that see enough tracks before bundle adjustment; after it all must.
        focal_spread: Largest relative spread of the focal lengths predicted for views of one camera.
        focal_factor: Largest factor between two estimates of the focal length: predicted, adjusted, from tracks alone.
        positive: Least share of the predicted depths that must be positive.
        off_px: Largest median distance of the tracks from the positions by predicted poses and depths, if the tracks
            alone cannot support a geometry.
        off_share: The same as a share of the tracks' median displacement: 1 for a camera at rest.
        path: Least extent of a predicted path that no track can check, in median depths.
    """

    registered: float = 0.75
    focal_spread: float = 0.2
    focal_factor: float = 1.5
    positive: float = 0.9
    off_px: float = 3.0
    off_share: float = 0.5
    path: float = 1e-3


PREDICTED: Final = PredictionCriteria()


def prior_by_name(name: str) -> GeometryPrior | None:
    """Return the prior of a name: "vggt", the model added under it; "vggt:FILE"; "vggt-or-tracks"; None: no such name.

    Raises:
        InputError: The model has not been added, or the file cannot be used.
        StorageError: The list of added models cannot be read.
    """
    if name.startswith(_FILE):
        return FromVggt(Path(name.removeprefix(_FILE)))
    if name == _OR_TRACKS and known_model("vggt") is None:
        return Source(PathSource.TRACKS, _tracks_for_vggt)
    return FromVggt(find_model("vggt")) if name in (PathSource.VGGT, _OR_TRACKS) else None


def _tracks_for_vggt(request: Request, progress: Progress) -> Geometry:
    """Find the tracks' geometry, the substitute for the paper's VGGT if no model has been added; a note says so."""
    note = finding(Code.TRACKS_FOR_VGGT)
    progress.say(note.sentence)
    found = from_tracks(request, progress)
    return replace(found, notes=(note, *found.notes))


class FromVggt:
    """The poses and depths that VGGT predicts, as far as the tracks confirm them.

    Args:
        path: The ONNX file.

    Raises:
        InputError: The file cannot be used.
    """

    name = "vggt"

    def __init__(self, path: Path) -> None:
        self._model = Vggt(path)

    def __call__(self, request: Request, progress: Progress) -> Geometry:
        """Find the geometry; see `GeometryPrior`."""
        said: list[str] = []
        first: tuple[Prediction, Focal] | None = None
        tracks: dict[bool, Tracks] = {}
        for number, (order, views) in enumerate(orders(len(request.views))):
            retry = number > 0
            wanted = replace(request, settings=_more_tracks(request.settings)) if retry else request
            if retry not in tracks:
                tracks[retry] = usable_tracks(wanted.views, wanted.settings, wanted.seen)
            if doubts_about_tracks(tracks[retry], wanted.size, wanted.settings.criteria) and first is not None:
                said.append(f"{order}: too few tracks")
                continue
            try:
                predicted = self._model.predict(request.views, views)
                prediction = check_prediction(predicted, len(request.views) // 2)
            except (NumericsError, GeometryError) as error:
                said.append(f"{order}: {error.problem}")
                continue
            camera = gated_camera(request, prediction, tracks[retry])
            first = first or (prediction, camera)
            found = _supported(wanted, tracks[retry], prediction, camera, order, said, progress)
            if found is not None:
                return found
        if first is None:
            raise NumericsError(f"no prediction could be used ({'; '.join(said)})")
        return _dense(request, *first, tracks[False], said)


def orders(count: int) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield the orders in which views are given to the model, by name, the same for every scene.

    The first view of an order defines the model's world frame.
    """
    forwards = tuple(range(count))
    yield "in order", forwards
    if count > 1:
        yield "backwards", forwards[::-1]
        yield "from the middle", forwards[count // 2 :] + forwards[: count // 2]
        yield "every other first", forwards[::2] + forwards[1::2]


def check_prediction(prediction: Prediction, reference: int) -> Prediction:
    """Return the prediction if its depths are positive.

    Raises:
        GeometryError: Too many are not.
    """
    positive = float((prediction.depth[reference] > 0).mean())
    if positive < PREDICTED.positive:
        raise GeometryError(f"{1 - positive:.0%} of the predicted depths are not positive")
    return prediction


def gated_camera(request: Request, prediction: Prediction, tracks: Tracks) -> Focal:
    """Accept or reject the predicted focal length.

    A known camera matrix is always used. Otherwise the prediction is accepted if it agrees between views, if it is in
    the range of real lenses, and if it agrees with the focal length that the tracks give, if they give any.
    """
    settings, size = request.settings, request.size
    focal = float(np.median(prediction.focal_px))
    known = request.intrinsics
    if known is not None:
        factor = _factor(focal, known[0, 0])
        doubt = finding(Code.VGGT_FOCAL_DIFFERS, focal_px=focal, known_px=float(known[0, 0]))
        return Focal(known.astype(np.float64), "file", (doubt,) if factor > PREDICTED.focal_factor else ())
    of_tracks = None
    if not doubts_about_tracks(tracks, size, settings.criteria):
        of_tracks = estimate_focal(tracks, size, settings.focal, settings.motion)
    why = _why_refused(prediction.focal_px, of_tracks, size, settings)
    if not why:
        return Focal(pinhole(focal, size), "estimated", (finding(Code.VGGT_FOCAL_TAKEN, focal_px=focal),))
    refused = finding(Code.VGGT_FOCAL_REFUSED, focal_px=focal, why=why)
    instead = of_tracks or default_focal(size, "there are too few tracks to estimate it", settings.focal)
    return Focal(instead.intrinsics, instead.source, (refused, *instead.notes))


def _why_refused(focals_px: F64, of_tracks: Focal | None, size: Size, settings: GeometrySettings) -> str:
    """Return why predicted focal lengths, [N], are rejected; nothing if they are accepted."""
    focal = float(np.median(focals_px))
    spread = float(np.ptp(focals_px)) / max(focal, 1.0)
    if spread > PREDICTED.focal_spread:
        return f"its views differ by {spread:.0%}"
    lenses = (settings.focal.widest_deg, settings.focal.narrowest_deg)
    shortest, longest = (focal_from_view_angle(angle, size[1]) for angle in lenses)
    if not shortest <= focal <= longest:
        return f"lenses lie between {shortest:.0f} and {longest:.0f} px"
    if of_tracks is None or of_tracks.source != "estimated":
        return ""
    factor = _factor(focal, float(of_tracks.intrinsics[0, 0]))
    return "the tracks tell another one" if factor > PREDICTED.focal_factor else ""


def _supported(
    request: Request,
    tracks: Tracks,
    prediction: Prediction,
    camera: Focal,
    order: str,
    said: list[str],
    progress: Progress,
) -> Geometry | None:
    """Return the prediction that tracks confirm, adjusted if possible; otherwise None, with the reasons in `said`."""
    if doubts := doubts_about_tracks(tracks, request.size, request.settings.criteria):
        said.append(f"{order}: {_in_a_row(doubts)}")
        return None
    steps: tuple[Step, ...] = ("after adjustment", "before adjustment")
    for step in steps:
        try:
            poses, intrinsics = prediction.world_to_camera, camera.intrinsics
            if step == "after adjustment":
                refine = camera.source != "file"
                huber = request.settings.motion.huber_px
                bundle = adjust_bundle(tracks, poses, intrinsics, huber, refine_focal=refine)
                poses, intrinsics = bundle.world_to_camera, bundle.intrinsics
            reasons = shortcomings(tracks, poses, intrinsics, camera, step, request.size, request.settings)
            if not reasons:
                found = initialise(request.views, intrinsics, request.settings, progress, poses, request.seen)
                reasons = () if found.has_path else found.notes
            why = _in_a_row(reasons)
        except GeometryError as error:
            why = error.problem
        if not why:
            note = finding(Code.VGGT_POSES_TAKEN, step=step, order=order, before=_after(said))
            notes = (note, *camera.notes, *found.notes)
            # A model's lengths have no unit.
            return replace(found, source=PathSource.VGGT, focal_source=camera.source, unit=None, notes=notes)
        said.append(f"{order}, {step}: {why}")
    return None


def shortcomings(
    tracks: Tracks,
    poses: F64,
    intrinsics: F64,
    camera: Focal,
    step: Step,
    size: Size,
    settings: GeometrySettings,
) -> Findings:
    """Return the criteria of the two track-supported steps that poses, [N, 4, 4], do not meet; nothing if they pass.

    All tracks start in the middle view, so the graph of views that share points is connected as soon as every view sees
    enough of them.

    Raises:
        GeometryError: The poses put the points behind the camera.
    """
    criteria = settings.criteria
    motion, explained = place_points(tracks, poses, intrinsics, settings.motion.huber_px, settings.motion.outlier_px)
    verdict, reasons = classify_motion(
        len(tracks), explained, motion, fit_rotations(explained, intrinsics, settings.motion), criteria
    )
    said = list(reasons) if verdict != Verdict.FULL else []
    said.extend(doubts_about_tracks(explained, size, criteria))
    registered = float(supported_views(explained, criteria).mean())
    least = 1.0 if step == "after adjustment" else PREDICTED.registered
    if registered < least:
        said.append(finding(Code.UNREGISTERED_VIEWS, share=registered, needed=least))
    factor = _factor(float(intrinsics[0, 0]), float(camera.intrinsics[0, 0]))
    if factor > PREDICTED.focal_factor:
        said.append(finding(Code.FOCAL_CHANGED, factor=factor))
    return tuple(said)


def _dense(request: Request, prediction: Prediction, camera: Focal, tracks: Tracks, said: list[str]) -> Geometry:
    """Return the geometry of the model's own cameras and depth, if the tracks do not contradict them.

    Raises:
        GeometryError: The tracks are too far from the predicted positions, or the camera does not move.
    """
    reference = len(request.views) // 2
    poses = relative_to(prediction.world_to_camera, reference)
    depth = prediction.depth[reference].astype(np.float64)
    unit = 1 / float(np.median(depth[depth > 0]))
    poses[:, :3, 3] *= unit
    inverse_depth = np.ones_like(depth)  # depths that are not positive are set to the median
    np.divide(1, depth * unit, out=inverse_depth, where=depth > 0)
    inverse_depth = inverse_depth.clip(*INVERSE_DEPTH_RANGE).astype(np.float32)
    tried, criteria = _after(said), request.settings.criteria
    if len(tracks) >= criteria.tracks:
        error, limit = _dense_error_px(tracks, inverse_depth, poses, camera.intrinsics, criteria.displacement_px)
        if error > limit:
            raise GeometryError(
                f"its depth and cameras miss the tracks by {error:.1f} px, more than {limit:.1f} px{tried}"
            )
        checked = f"the tracks lie {error:.1f} px from them"
    else:
        checked = "there are too few tracks to check them"
        if np.ptp(camera_centres(poses), axis=0).max(initial=0) < PREDICTED.path:
            raise GeometryError(f"its camera does not move{tried}")
    note = finding(Code.VGGT_DEPTH_TAKEN, checked=checked, before=tried)
    return Geometry(
        world_to_camera=poses,
        intrinsics=camera.intrinsics,
        focal_source=camera.source,
        inverse_depth=inverse_depth,
        reference=reference,
        tracks=0,
        reprojection_rms_px=0.0,
        parallax_px=0.0,
        verdict=Verdict.FULL,
        notes=(note, *camera.notes),
        source=PathSource.VGGT,
    )


def _dense_error_px(
    tracks: Tracks, inverse_depth: F32, poses: F64, intrinsics: F64, least_px: float
) -> tuple[float, float]:
    """Return the median distance of tracks from the positions by cameras and depth, and what is allowed."""
    height, width = inverse_depth.shape
    corners = tracks.positions[:, tracks.reference]
    columns, rows = corners[:, 0].astype(int).clip(0, width - 1), corners[:, 1].astype(int).clip(0, height - 1)
    predicted = predict_positions(corners, inverse_depth[rows, columns].astype(np.float64), poses, intrinsics)
    elsewhere = tracks.seen.copy()
    elsewhere[:, tracks.reference] = False
    error = np.median(np.linalg.norm(predicted - tracks.positions, axis=-1)[elsewhere])
    displacement = np.median(np.linalg.norm(corners[:, None] - tracks.positions, axis=-1)[elsewhere])
    limit = max(least_px, PREDICTED.off_share * float(displacement))
    return float(error), min(PREDICTED.off_px, limit)


def _more_tracks(settings: GeometrySettings) -> GeometrySettings:
    """Return settings for a retry: three times the corners, weaker and closer together."""
    wanted = settings.tracks
    corners, quality, spacing_px = 3 * wanted.corners, 0.2 * wanted.quality, 0.6 * wanted.spacing_px
    return replace(settings, tracks=replace(wanted, corners=corners, quality=quality, spacing_px=spacing_px))


def _factor(a: float, b: float) -> float:
    return max(a / b, b / a) if a > 0 and b > 0 else float("inf")


def _in_a_row(findings: Findings) -> str:
    return " ".join(found.sentence for found in findings).rstrip(".")


def _after(said: list[str]) -> str:
    return f" (before that: {'; '.join(said)})" if said else ""
