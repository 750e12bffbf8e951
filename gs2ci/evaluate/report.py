"""What `report.json` says: the figures of one run, as plain JSON values. Schema `gs2ci.report/1`.

Here: the report's content and its reading. Not here: the run folder's other files (`gs2ci.evaluate.run_folder`), the
picture (`gs2ci.evaluate.overview`).
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.errors import StorageError
from gs2ci.core.json_text import parse_json
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate import environment
from gs2ci.evaluate.metrics import image_scores, measurement_residual
from gs2ci.evaluate.trajectory import trajectory_errors

SCHEMA: Final = "gs2ci.report/1"
REPORT_NAME: Final = "report.json"
REGISTERED_NAME: Final = "registered.h5"

_DECODE_SENTENCE: Final = (
    "The scene does not explain the measurement better than the decode does: views.npy and the figures are the "
    "decode's, what the scene shows is in scene_views.npy."
)
_FREE_SENTENCES: Final = {
    "roll": "The camera path is too straight for its positions to tell the rotation about it to a degree; "
    "rotation_deg takes that roll from the cameras' own orientations.",
    "rotation": "A camera that stands still leaves the alignment without scale and rotation; rotation_deg takes "
    "the rotation from the cameras' own orientations, and ate is at the estimate's own scale.",
}


def build_report(shot: Shot, result: RunResult) -> dict[str, Any]:
    """Collect the figures of one run; what needs an unknown truth is None.

    `psnr_db`, `ssim` and `residual` speak of the recovered views; `scene` and `decode` of what these two alone give.

    Args:
        shot: The measurement, with its truth if there is one.
        result: What was recovered from it.
    """
    n, height, width, channels = result.views.shape
    recovered, scene, decode = (
        image_scores(views, shot.truth.views) for views in (result.views, result.scene_views, result.decode)
    )
    trajectory, sentences = _trajectory(shot, result)
    seen = result.registered or shot
    residual = measurement_residual(result.predicted_measurement, seen.measurement, seen.saturated)
    report = {
        "schema": SCHEMA,
        "name": shot.name,
        "views": n,
        "size": [height, width],
        "channels": channels,
        "cfa": shot.cfa,
        "verdict": result.verdict,
        "notes": [*([_DECODE_SENTENCE] if result.verdict == "decode" else []), *result.notes, *sentences],
        **recovered,
        "scene": scene,
        "decode": decode,
        "trajectory": trajectory,
        "residual": {
            **asdict(residual),
            "heldout_rms": dict(result.heldout_rms),
        },
        "seconds": dict(result.seconds),
        "curve": [asdict(point) for point in result.curve],
        "gaussians": result.gaussians,
        "stopped_because": result.stopped_because,
        "ensemble": dict(result.ensemble),
        "geometry": dict(result.geometry),
        "brightness": result.brightness,
        "registration": dict(result.registration),
        "measured": _measured(shot),
        "peak_mib": round(environment.peak_mib(), 1),
        "settings": dict(result.settings),
        "seed": result.seed,
        "versions": environment.versions(),
        "machine": environment.machine(),
        "provenance": shot.provenance,
    }
    plain: dict[str, Any] = plain_json(report)
    return plain


def plain_json(value: Any) -> Any:
    """Reduce a value to what JSON can hold; a number that is not finite becomes None, the unknown its text."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case np.generic() | np.ndarray():
            return plain_json(value.tolist())
        case Mapping():
            return {str(key): plain_json(item) for key, item in value.items()}
        case list() | tuple():
            return [plain_json(item) for item in value]
        case _ if is_dataclass(value) and not isinstance(value, type):
            return plain_json(asdict(value))
        case _:
            return str(value)


def read_report(folder: Path, schema: str = SCHEMA) -> dict[str, Any]:
    """Read the report of a run folder, or of another folder of ours with a report of another schema.

    Raises:
        StorageError: There is none, it is cut short, or its schema is another.
    """
    path = Path(folder) / REPORT_NAME
    remedy = "give the folder that `gs2ci reconstruct -o` wrote" if schema == SCHEMA else ""
    try:
        report = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise StorageError(f"{path} cannot be read: {reason}", remedy=remedy) from error
    if not isinstance(report, dict) or report.get("schema") != schema:
        found = report.get("schema") if isinstance(report, dict) else type(report).__name__
        raise StorageError(f"{path} has schema {found!r}", allowed=schema, remedy=remedy)
    return report


def masks_digest(shot: Shot) -> str:
    """Digest the masks, so that a report tells which they were."""
    return hashlib.sha256(np.ascontiguousarray(shot.masks, "<f4").tobytes()).hexdigest()


def _measured(shot: Shot) -> dict[str, Any]:
    """Say what the measurement and its masks are like, before anything is solved."""
    return {
        "mean": float(shot.measurement.mean(dtype=np.float64)),
        "masks_sha256": masks_digest(shot),
        "open_share": float(shot.masks.mean(dtype=np.float64)),
        "grey_share": float(np.mean((shot.masks > 0) & (shot.masks < shot.masks.max()))),
        "closed_share": float(np.mean(~shot.lit)),
        "saturated_share": None if shot.saturated is None else float(shot.saturated.mean()),
        "weights": [float(shot.weights.min()), float(shot.weights.max())],
        "telemetry": shot.telemetry_world_to_camera is not None,
    }


def _trajectory(shot: Shot, result: RunResult) -> tuple[dict[str, float | None] | None, list[str]]:
    truth = shot.truth.world_to_camera
    if truth is None:
        return None, []
    errors = asdict(trajectory_errors(result.world_to_camera, truth))
    free = errors.pop("free")
    return errors, [_FREE_SENTENCES[free]] if free in _FREE_SENTENCES else []
