"""A made-up report to change one thing of at a time. Nothing here is a test."""

import copy
import json
from dataclasses import asdict
from typing import Any

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.run_figures import GeometrySection, Moved
from gs2ci.evaluate.report import Report

GEOMETRY: dict[str, Any] = {
    "method": "tracks",
    "asked_for": "auto",
    "proxy": "gap-tv",
    "verdict": "full",
    "focal_px": 290.0,
    "focal_source": "file",
    "tracks": 800,
    "reprojection_rms_px": 1.1,
    "parallax_px": 3.0,
    "path_error_expected": 0.01,
    "reference": 4,
    "unit_of": None,
    "moved": {"rotation_deg": 0.01, "share_of_path": 0.001},
}


def a_geometry(**changes: Any) -> GeometrySection:
    """Make the section of a good path, with changes."""
    return GeometrySection(**{**GEOMETRY, "moved": Moved(**GEOMETRY["moved"]), **changes})


# A measurement that nobody simulated, 8 views with a truth, and nothing to complain of.
GOOD: dict[str, Any] = {
    "schema": "gs2ci.report/2",
    "name": "waves",
    "views": 8,
    "size": [48, 64],
    "channels": 3,
    "cfa": None,
    "verdict": "refined",
    "notes": [],
    "psnr_db": {"mean": 31.0, "per_view": [31.0] * 8},
    "ssim": {"mean": 0.94, "per_view": [0.94] * 8},
    "scene": {"psnr_db": {"mean": 30.0, "per_view": [30.0] * 8}, "ssim": {"mean": 0.93, "per_view": [0.93] * 8}},
    "decode": {"psnr_db": {"mean": 24.0, "per_view": [24.0] * 8}, "ssim": {"mean": 0.7, "per_view": [0.7] * 8}},
    "trajectory": {
        "ate": 0.004,
        "nate": 0.001,
        "translation_mean": 0.003,
        "rotation_deg": 0.1,
        "rpe_t": 0.003,
        "rpe_r_deg": 0.02,
    },
    "residual": {"rms": 0.03, "mean_abs": 0.02, "heldout_rms": {"refined": 0.02, "scene": 0.021, "decode": 0.05}},
    "seconds": {"total": 86.2, "decode": 4.0, "geometry": 4.2, "fit": 78.0},
    "curve": [
        {
            "seconds": 10.0 + i,
            "iteration": 50 * i,
            "loss": 0.1,
            "heldout": 0.1 - 0.01 * i + 0.002 * max(0, i - 5) ** 2,
            "psnr_db": 20.0 + i,
            "gaussians": 9000,
        }
        for i in range(11)
    ],
    "gaussians": 13000,
    "stopped": asdict(finding(Code.FIT_STALLED, best=500)),
    "ensemble": {"fits": 4, "averaged": 4, "spread": 0.01},
    "geometry": GEOMETRY,
    "brightness": None,
    "measured": {
        "mean": 0.5,
        "masks_sha256": "0" * 64,
        "open_share": 0.25,
        "grey_share": 0.0,
        "closed_share": 0.01,
        "saturated_share": 0.0,
        "weights": [1.0, 1.0],
        "telemetry": True,
    },
    "simulation": {"error_dn": 0.8, "tolerance_dn": 1.0, "views": 60, "effects": {}},
    "peak_mib": 812.3,
    "settings": {"fit": {"iterations": 1000}},
    "seed": 0,
    "versions": {"python": "3.11"},
    "machine": {
        "processor": "a processor",
        "architecture": "x86_64",
        "usable_cores": 4,
        "memory_mib": 1000,
        "system": "Linux",
    },
    "provenance": {},
}


def a_report(*notes: Finding, stopped: Finding | None = None, **changes: Any) -> Report:
    """Make a good report with findings and changes; a key a__b changes what lies in a."""
    found = copy.deepcopy(GOOD)
    found["notes"] = [asdict(note) for note in notes]
    found["stopped"] = found["stopped"] if stopped is None else asdict(stopped)
    for key, value in changes.items():
        *path, last = key.split("__")
        at = found
        for part in path:
            at = at[part]
        at[last] = value
    return Report.model_validate_json(json.dumps(found))
