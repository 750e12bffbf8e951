"""What calibration is worth: one measurement reconstructed with nominal, calibrated and true masks, in dB.

The bench is misregistered, has finite contrast and a blurring relay. It is calibrated through its drivers, step by
step as `gs2ci calibrate` does, measured one by one and predicted (`--fast`); then it takes one coded exposure of a
scene while the stage moves the camera. Nominal masks are the codes that were sent, true ones what the simulator let
through. Noise of the sensor and of the calibration is in all of it.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.core.records import F32, Shot
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.rig.calibrating import bench_of, operator_of
from gs2ci.rig.config import RigTable
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci.rig.truth import truth_of
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES

SIZE = (96, 128)
BITS = 12
STEPS = ("dark-flat", "sensor", "registration", "masks")
MASKS_S = 0.02
BENCHES: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "a little off": {
        "misregistration": {"right_px": 0.3, "down_px": -0.2, "turn_mrad": 1.0},
        "finite_contrast": {"contrast": 40.0},
        "modulator_psf": {"sigma_px": 0.35},
    },
    "off": {
        "misregistration": {"right_px": 1.2, "down_px": -0.7, "turn_mrad": 4.0, "magnification": 1.004},
        "finite_contrast": {"contrast": 15.0},
        "modulator_psf": {"sigma_px": 0.5},
    },
    "far off, soft": {
        "misregistration": {"right_px": -2.4, "down_px": 1.6, "turn_mrad": -8.0, "magnification": 0.994},
        "finite_contrast": {"contrast": 8.0},
        "modulator_psf": {"sigma_px": 0.8},
    },
}
"""Name of a bench -> what its light path suffers."""
DECODE: Mapping[str, Callable[[Shot], F32]] = {
    "decode": gap_tv,
    "reconstruction": lambda shot: reconstruct(shot).views,
}


@dataclass(frozen=True)
class Case:
    """One measurement, with each kind of masks.

    Args:
        shots: By kind of masks: "nominal", "calibrated", "predicted", "true".
        mask_error: Error of the masks, rms, by kind.
    """

    shots: dict[str, Shot]
    mask_error: dict[str, float]


def table(effects: Mapping[str, Mapping[str, float]], seed: int, size: tuple[int, int] = SIZE) -> RigTable:
    """Return the rig file of a bench."""
    height, width = size
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900"},
            "sensor": {
                "kind": "v4l2",
                "height": height,
                "width": width,
                "format": "Y12",
                "black_level_dn": 64.0,
                "full_well_e": 10700.0,
                "electrons_per_dn": 2.7,
            },
            "stage": {"kind": "zaber", "mount": {}},
            "registration": {"superpixel": 2},
            "capture": {"masks": 8, "mask_s": MASKS_S, "seed": seed, "axis": "x", "from_mm": 73.0, "to_mm": 77.0},
            "optics": {"full_scale_e_per_s": 1e5},
            "world": {
                "scene": "planes",
                "seed": seed,
                "height": height,
                "width": width,
                "scene_units_per_mm": 0.02,
                "flat_radiance": 0.8,
                "effects": {name: dict(told) for name, told in effects.items()},
            },
        }
    )


def take(effects: Mapping[str, Mapping[str, float]], seed: int, size: tuple[int, int] = SIZE) -> Case:
    """Calibrate a bench and take one shot with it."""
    told = table(effects, seed, size)
    rig = Rig(told, told.model_dump_json(), Path(), build_bench(told))
    assert rig.bench is not None
    devices = rig.open()
    try:
        operator = operator_of(rig, print)
        measured = _calibrated(bench_of(rig, devices, operator))
        predicted = _calibrated(bench_of(rig, devices, operator, fast=True))
        with tempfile.TemporaryDirectory() as folder:
            prepared = prepare(rig, devices)
            path = record(rig, devices, prepared, Path(folder) / "shot.h5", replace=True, progress=Silent())
            shot = read_shot(path)
        shown = bench_of(rig, devices, operator).capture.masks
        true = truth_of(rig.bench, BITS).masks(shown)
        intervals = rig.bench.world.exposures[-1].masks
        weights = np.array([(mask.end_s - mask.start_s) / MASKS_S for mask in intervals], np.float32)
    finally:
        devices.close()
    shots = {
        "nominal": shot,
        "calibrated": _with_masks(shot, measured),
        "predicted": _with_masks(shot, predicted),
        "true": replace(shot, masks=true, weights=weights).check(),
    }
    return Case(shots, {name: float(np.sqrt(np.mean(np.square(one.masks - true)))) for name, one in shots.items()})


def _calibrated(bench: Any) -> Bundle:
    known = Bundle()
    for step in STEPS:
        known = known.with_section(PROCEDURES[step](bench, known))
    return known


def _with_masks(shot: Shot, known: Bundle) -> Shot:
    """Give a shot the masks and weights of a bundle."""
    section = known.sections["masks"]
    masks = np.clip(section.array("masks"), 0, 1).astype(np.float32)
    return replace(shot, masks=masks, weights=section.array("weights").astype(np.float32)).check()


def score(shot: Shot, recover: Callable[[Shot], F32]) -> float:
    """Return the mean PSNR of the recovered views, in dB."""
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(recover(shot), shot.truth.views)))


def run() -> None:
    """Calibrate, capture and reconstruct on each bench; print dB by kind of masks."""
    print("| bench | by | nominal | calibrated | predicted | true | calibrated under true |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for seed, (name, effects) in enumerate(BENCHES.items()):
        case = take(effects, seed)
        errors = " | ".join(f"{100 * error:.2f}" for error in case.mask_error.values())
        print(f"| {name} | mask error, % rms | {errors} | |", flush=True)
        for by, recover in DECODE.items():
            figures = {kind: score(shot, recover) for kind, shot in case.shots.items()}
            cells = " | ".join(f"{figure:.2f}" for figure in figures.values())
            print(f"| {name} | {by}, dB | {cells} | {figures['true'] - figures['calibrated']:+.2f} |", flush=True)
