"""Evaluating a finished run: by a truth given afterwards, by the sensor's noise, by views from other poses.

Here: which figures follow from which data, and which of several shots belongs to which views of a joint run. Not here:
the metrics (one file each), the run's own report (`gs2ci.evaluate.report`). Schema `gs2ci.evaluation/2`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.json_text import as_json, plain_json
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_earlier, write_whole
from gs2ci.evaluate.depth import depth_errors, parallax_of
from gs2ci.evaluate.metrics import SensorNoise, chi_squared_per_pixel, image_scores, measurement_residual
from gs2ci.evaluate.novel_views import NovelViews, score_novel_views
from gs2ci.evaluate.pages.run_evidence import FinishedRun
from gs2ci.evaluate.report import MeasurementSection, Report
from gs2ci.evaluate.run_report import masks_digest
from gs2ci.evaluate.trajectory import align, trajectory_errors
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.paper.perceptual import PerceptualDistance
from gs2ci.render.ply import read_ply

SCHEMA: Final = "gs2ci.evaluation/2"
SAME_SCALE: Final = 1e-3
"""Measurements whose means differ by less than this, relatively, count as of one scale: it is 0.009 dB."""


@dataclass(frozen=True)
class ReferenceData:
    """The data for judging a run; figures whose data are None are left out.

    Args:
        shot: The measurement, with its truth.
        depth: True depth, [N, H, W], instead of the shot's own.
        novel: True views from other poses.
        noise: Noise of the sensor.
        lpips: A learned perceptual distance provided by the user (`gs2ci.reconstruct.paper.perceptual`).
        exposures: Those of a joint run, of which `shot` is the sum, in the order of their views (`_of_exposures`).
    """

    shot: Shot
    depth: F32 | None = None
    novel: NovelViews | None = None
    noise: SensorNoise | None = None
    lpips: PerceptualDistance | None = None
    exposures: tuple[Shot, ...] = ()


def evaluate(run: FinishedRun, evidence: ReferenceData) -> dict[str, Any]:
    """Evaluate a run; a figure without the data for it is None.

    Raises:
        InputError: The data are of another shot: sizes or counts differ; or novel views come without true poses, or
            are of another size.
    """
    shot = evidence.shot
    views = run.views[..., : shot.channels]
    if views.shape != (*shot.masks.shape, shot.channels):
        raise InputError(
            f"a run of views {list(run.views.shape)} beside a shot of {shot.views} views, {list(shot.size)}",
            allowed="the shot that was reconstructed",
        )
    true_path = shot.truth.world_to_camera
    found = {
        "schema": SCHEMA,
        "name": shot.name,
        **_of_views(run, evidence, slice(0, len(views))),
        "trajectory": None if true_path is None else asdict(trajectory_errors(run.world_to_camera, true_path)),
        "novel_views": None if evidence.novel is None else _novel(run, shot, evidence.novel),
        "notes": _notes(run.report.measured, shot),
        "exposures": _of_exposures(run, evidence),
    }
    return plain_json(found)


def _of_views(run: FinishedRun, evidence: ReferenceData, chosen: slice) -> dict[str, Any]:
    """Return the figures of views beside those of a shot, which are the chosen ones of the run."""
    shot, truth = evidence.shot, evidence.shot.truth
    views = run.views[chosen][..., : shot.channels]
    return {
        **image_scores(views, truth.views),
        "lpips": _perceptual(views, truth.views, evidence.lpips),
        "depth": _depth(run, evidence, chosen),
        "residual": _residual(run, evidence, chosen),
    }


def _of_exposures(run: FinishedRun, evidence: ReferenceData) -> list[dict[str, Any]]:
    """Return the figures of each exposure of a joint run; none for a run of one."""
    corrected, found, first = run.registered, [], 0
    # The readings of each exposure, if registration corrected them, were not kept.
    readings_known = corrected is None or bool(np.allclose(corrected.measurement, evidence.shot.measurement, atol=1e-4))
    for shot in evidence.exposures:
        chosen = slice(first, first + shot.views)
        depth = None if evidence.depth is None else evidence.depth[chosen]
        own = replace(evidence, shot=shot, depth=depth, exposures=())
        figures = _of_views(run, own, chosen)
        if not readings_known:
            figures["residual"] = None
        found.append({"name": shot.name, "first_view": first, "views": shot.views, **figures})
        first = chosen.stop
    return found


def _residual(run: FinishedRun, evidence: ReferenceData, chosen: slice) -> dict[str, Any]:
    """Return what chosen views leave of a shot's readings, through masks as the run corrected them."""
    shot, corrected, brightness = evidence.shot, run.registered, run.report.brightness
    if corrected is None:
        seen = shot
    elif shot.views == corrected.views:
        seen = corrected
    else:
        seen = replace(shot, masks=corrected.masks[chosen], weights=corrected.weights[chosen])
    coded = (run.views if run.exposed is None else run.exposed)[chosen][..., : shot.channels]
    predicted = _predicted(seen, coded, None if brightness is None else brightness[chosen])
    return {
        **asdict(measurement_residual(predicted, seen.measurement, seen.saturated)),
        "chi2_per_pixel": None
        if evidence.noise is None
        else chi_squared_per_pixel(predicted, seen.measurement, evidence.noise, seen.saturated),
    }


def check_evaluation_place(path: Path) -> None:
    """Check before the work that an evaluation to be written replaces none but an earlier one, of any version.

    Raises:
        StorageError: Something else lies there, for example one of the inputs.
    """
    check_earlier(path, SCHEMA.partition("/")[0].encode() + b"/", "an evaluation")


def write_evaluation(path: Path, evaluation: dict[str, Any]) -> Path:
    """Write an evaluation as JSON, completely or not at all; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    return write_whole(path, as_json(evaluation), remedy="choose another place with -o")


def _predicted(shot: Shot, views: F32, brightness: Sequence[float] | None) -> F32:
    """Code views as the run did: with the weights that it corrected, if any."""
    lit = replace(shot, weights=shot.weights_by(brightness))
    return Coding.of(lit).forward(torch.from_numpy(np.array(views))).numpy()


def _notes(measured: MeasurementSection, shot: Shot) -> list[Finding]:
    """Return notes on differences between this shot and the one that the run used."""
    notes = []
    ratio = float(shot.measurement.mean(dtype=np.float64)) / measured.mean if measured.mean else 1.0
    if abs(ratio - 1) > SAME_SCALE:
        notes.append(finding(Code.OTHER_SCALE, ratio=ratio))
    if measured.masks_sha256 != masks_digest(shot):
        notes.append(finding(Code.OTHER_MASKS))
    return notes


def _perceptual(views: F32, truth: F32 | None, distance: PerceptualDistance | None) -> dict[str, Any] | None:
    """Compare in three channels, both clamped to [0, 1]: a grey view is repeated."""
    if truth is None or distance is None:
        return None
    pairs = [
        [torch.from_numpy(np.clip(np.broadcast_to(one, (*one.shape[:2], 3)), 0, 1).astype(np.float32)) for one in pair]
        for pair in zip(views, truth, strict=True)
    ]
    with torch.no_grad():
        each = [float(distance(*pair)) for pair in pairs]
    return {"mean": float(np.mean(each)), "per_view": each}


def _depth(run: FinishedRun, evidence: ReferenceData, chosen: slice) -> dict[str, Any] | None:
    truth = evidence.shot.truth.depth if evidence.depth is None else evidence.depth
    if run.depth is None or truth is None:
        return None
    # Depth given separately may be in a unit of its own.
    path = evidence.shot.truth.world_to_camera if evidence.depth is None else None
    errors = depth_errors(run.depth[chosen], truth, None if path is None else parallax_of(path, run.intrinsics))
    return None if errors is None else asdict(errors)


def _novel(run: FinishedRun, shot: Shot, novel: NovelViews) -> dict[str, Any]:
    true_path = shot.truth.world_to_camera
    if true_path is None:
        raise InputError(
            "novel views need the true camera path, and the shot does not hold it",
            remedy="import the measurement with its world_to_camera",
        )
    size, own = novel.views.shape[1:3], run.views.shape[1:3]
    if size != own:
        raise InputError(
            f"novel views of {size[0]} x {size[1]} px beside a run of {own[0]} x {own[1]} px",
            allowed="pictures of the run's size, as its camera matrix holds for them alone",
            remedy="crop and scale them like the measurement",
        )
    alignment = align(run.world_to_camera, true_path)
    intrinsics = run.intrinsics if shot.intrinsics is None else shot.intrinsics
    return {
        **score_novel_views(read_ply(run.folder / "scene.ply"), alignment, intrinsics, novel),
        "alignment_free": alignment.free,
    }


def exposures_of(report: Report, shots: Sequence[Shot]) -> list[Shot]:
    """Return the shots of a run in the order of its views.

    Shots are found by the names of the run's exposures, in any order; those that it left out are passed over. If names
    do not tell, as many as the run has are taken as they are given.

    Args:
        report: Of the run.
        shots: One or more; of a run of one exposure, that one.

    Raises:
        InputError: They are not those of the run: some are missing, or there are more of one name than it has.
    """
    wanted = [one.name for one in report.exposures] or [report.name]
    given, of_run = Counter(shot.name for shot in shots), Counter(wanted)
    lacking = [name for name in of_run if given[name] < of_run[name]]
    doubtful = [name for name in of_run if given[name] > of_run[name]]
    if len(shots) == len(wanted) and lacking:
        return list(shots)
    if lacking or doubtful:
        told = f"{', '.join(lacking or doubtful)} {'is missing' if lacking else 'is there more than once'}"
        raise InputError(
            f"{len(shots)} given of {len(wanted)} exposures of the run: {told}",
            allowed="the exposures that were reconstructed",
            remedy="give the files of the run, all exposures of each, in the same order; see --index",
        )
    by_name: dict[str, list[Shot]] = {}
    for shot in shots:
        by_name.setdefault(shot.name, []).append(shot)
    return [by_name[name].pop(0) for name in wanted]
