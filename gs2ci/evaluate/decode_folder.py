"""The folder that `gs2ci decode` writes, completely or not at all.

    decoded/
      report.json    method, quality and time of the decode; schema gs2ci.decode/1
      views.npy      the views of all shots in order of exposure, [S * N, H, W, C] float32, full scale 1
      views/         the same as 8-bit pictures, clamped to [0, 1]

Not here: decoding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.json_text import as_json
from gs2ci.core.records import Shot
from gs2ci.evaluate import environment
from gs2ci.evaluate.metrics import measurement_residual, psnr_per_view, ssim_per_view
from gs2ci.evaluate.whole_folder import REPORT_NAME, whole_folder, write_pictures

SCHEMA: Final = "gs2ci.decode/1"


@dataclass(frozen=True)
class Decoded:
    """One decoded shot.

    Args:
        shot: The measurement, with its truth if there is one.
        views: [N, H, W, C] float32, full scale 1.
        predicted_measurement: The views coded by the masks, comparable with the shot's measurement.
        seconds: Time that the decode took.
        method: The method and its settings, as plain values.
        notes: Sentences for the reader of the report.
    """

    shot: Shot
    views: F32
    predicted_measurement: F32
    seconds: float
    method: Mapping[str, Any]
    notes: Sequence[str] = ()


def write_decoded(folder: Path, decoded: Sequence[Decoded], *, overwrite: bool = False) -> dict[str, Any]:
    """Write decoded shots of one file; the folder appears complete or not at all.

    Args:
        folder: Where; parents are made.
        decoded: The shots, at least one, all of the same size.
        overwrite: Replace an earlier decode at this place.

    Returns:
        The report.

    Raises:
        InputError: Nothing to write.
        NumericsError: Views hold numbers that are not finite.
        StorageError: The place holds something else, or the disk refuses.
    """
    if not decoded:
        raise InputError("no decoded shot to write", allowed="at least one")
    views = np.concatenate([one.views for one in decoded])
    if not np.isfinite(views).all():
        raise NumericsError("decoded views hold numbers that are not finite", remedy="use another denoiser")
    report = _report(decoded)
    with whole_folder(Path(folder), overwrite=overwrite, schema=SCHEMA) as partial:
        np.save(partial / "views.npy", views.astype(np.float32, copy=False))
        write_pictures(partial / "views", views)
        (partial / REPORT_NAME).write_text(as_json(report), encoding="utf-8")
    return report


def _report(decoded: Sequence[Decoded]) -> dict[str, Any]:
    shots = [_shot_report(one) for one in decoded]
    first = decoded[0].shot
    means: dict[str, float | None] = {}
    for key in ("psnr_db", "ssim"):
        known = [value for shot in shots if shot[key] is not None for value in shot[key]]
        means[key] = float(np.mean(known)) if known else None
    return {
        "schema": SCHEMA,
        "name": first.name,
        "views": first.views,
        "size": list(first.size),
        "channels": int(decoded[0].views.shape[-1]),
        "cfa": first.cfa,
        **means,
        "seconds": sum(one.seconds for one in decoded),
        "shots": shots,
        "versions": environment.versions(),
        "machine": asdict(environment.machine()),
    }


def _shot_report(one: Decoded) -> dict[str, Any]:
    truth = one.shot.truth.views
    return {
        "name": one.shot.name,
        "method": dict(one.method),
        "psnr_db": None if truth is None else psnr_per_view(one.views, truth),
        "ssim": None if truth is None else ssim_per_view(one.views, truth),
        "residual": asdict(measurement_residual(one.predicted_measurement, one.shot.measurement, one.shot.saturated)),
        "seconds": one.seconds,
        "notes": list(one.notes),
    }
