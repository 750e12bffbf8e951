"""Collecting the figures of one run into its report.

Here: the source of each section of `gs2ci.evaluate.report`. Not here: what the sections are, the run folder
(`gs2ci.evaluate.run_folder`), the picture (`gs2ci.evaluate.overview`).
"""

import hashlib
from dataclasses import asdict, fields
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.json_text import as_json, plain_json
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate import environment
from gs2ci.evaluate.depth import DepthErrors, depth_errors, parallax_of
from gs2ci.evaluate.metrics import image_scores, measurement_residual
from gs2ci.evaluate.report import MeasurementSection, Report, Simulation
from gs2ci.evaluate.sureness import figures_of_errors
from gs2ci.evaluate.trajectory import TrajectoryErrors, trajectory_errors
from gs2ci.evaluate.whole_folder import RUN_SCHEMA

_FREE: Final = {"roll": Code.TRUE_PATH_STRAIGHT, "rotation": Code.TRUE_PATH_STILL}


def build_report(shot: Shot, result: RunResult) -> Report:
    """Collect the figures of one run.

    Args:
        shot: The measurement, with its truth if there is one.
        result: The result of its reconstruction.
    """
    n, height, width, channels = result.views.shape
    found = {one.name: getattr(result, one.name) for one in fields(result) if one.name in Report.model_fields}
    recovered, scene, decode = (
        image_scores(views, shot.truth.views) for views in (result.views, result.scene_views, result.decode)
    )
    depth = _depth(shot, result)
    trajectory, about_truth = _trajectory(shot, result, depth)
    seen = result.registered or shot
    residual = measurement_residual(result.predicted_measurement, seen.measurement, seen.saturated)
    decode_kept = (finding(Code.DECODE_KEPT),) if result.verdict == "decode" else ()
    simulation, provenance = _simulation(plain_json(shot.provenance))
    # What a report has by the name of something else in the result comes after what it takes from there.
    report = found | {
        "schema": RUN_SCHEMA,
        "name": shot.name,
        "views": n,
        "size": [height, width],
        "channels": channels,
        "cfa": shot.cfa,
        "notes": [*decode_kept, *result.notes, *about_truth],
        **recovered,
        "scene": scene,
        "decode": decode,
        "trajectory": trajectory,
        "depth": depth,
        "residual": {**asdict(residual), "heldout_rms": result.heldout_rms},
        "sureness": figures_of_errors(result),
        "measured": _measured(shot),
        "simulation": simulation,
        "peak_mib": round(environment.peak_mib(), 1),
        "versions": environment.versions(),
        "machine": environment.machine(),
        "provenance": provenance,
    }
    # Converted through JSON, so that it is the same as when it is read back.
    return Report.model_validate_json(as_json(report))


def masks_digest(shot: Shot) -> str:
    """Return a hash of the masks, so that a report identifies them."""
    return hashlib.sha256(np.ascontiguousarray(shot.masks, "<f4").data).hexdigest()


def _simulation(provenance: dict[str, Any]) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Return the simulator's plan from a shot's provenance, if that contains a valid one."""
    plan = provenance.get("plan")
    try:
        Simulation.model_validate(plan)
    except ValidationError:
        return None, provenance
    return plan, {key: value for key, value in provenance.items() if key != "plan"}


def _measured(shot: Shot) -> MeasurementSection:
    return MeasurementSection(
        mean=float(shot.measurement.mean(dtype=np.float64)),
        masks_sha256=masks_digest(shot),
        open_share=float(shot.masks.mean(dtype=np.float64)),
        grey_share=float(np.mean((shot.masks > 0) & (shot.masks < shot.masks.max()))),
        closed_share=float(np.mean(~shot.lit)),
        saturated_share=None if shot.saturated is None else float(shot.saturated.mean()),
        weights=(float(shot.weights.min()), float(shot.weights.max())),
        telemetry=shot.telemetry_world_to_camera is not None,
    )


def _depth(shot: Shot, result: RunResult) -> DepthErrors | None:
    if shot.truth.depth is None or result.depth is None:
        return None
    path = shot.truth.world_to_camera
    parallax = None if path is None else parallax_of(path, result.intrinsics)
    return depth_errors(result.depth, shot.truth.depth, parallax)


def _trajectory(
    shot: Shot, result: RunResult, depth: DepthErrors | None
) -> tuple[TrajectoryErrors | None, tuple[Finding, ...]]:
    truth = shot.truth.world_to_camera
    if truth is None:
        return None, ()
    errors = trajectory_errors(result.world_to_camera, truth)
    said = [finding(_FREE[errors.free])] if errors.free in _FREE else []
    if errors.reversed:
        rank = None if depth is None else depth.rank_in_order
        reversed_ = finding(Code.TRUE_PATH_REVERSED)
        said.append(reversed_ if rank is None else finding(Code.TRUE_PATH_CONTRADICTED, rank=rank))
    return errors, tuple(said)
