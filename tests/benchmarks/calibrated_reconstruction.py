"""The effect of calibration: one measurement reconstructed with nominal, calibrated and true masks, in dB.

The bench is misregistered, has finite contrast and a blurring relay. It is calibrated through its drivers, step by
step as `gs2ci calibrate` does, with masks measured one by one and predicted (`--fast`); then it takes coded exposures
of a scene while the stage moves the camera, as `gs2ci capture` does with and without a bundle. Nominal masks are the
codes that were sent; true masks are the simulator's transmissions and replace the calibrated ones. All results contain
the noise of the sensor and of the calibration.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import GeometryError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.rig.calibrated import Calibrated, load
from gs2ci.rig.calibrating import bench_of, operator_of, provenance_of
from gs2ci.rig.config import RigTable
from gs2ci.rig.intent import intended
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci_calibration.bench import Arrangement
from gs2ci_calibration.bundle import Bundle, add_section, read_bundle
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_drivers.acquisition import Devices
from tests.bench_truth import truth_of

SIZE = (96, 128)
BITS = 12
STEPS = ("dark-flat", "sensor", "registration", "masks")
MASKS_S = 0.02
MODES: Mapping[str, bool] = {"calibrated": False, "predicted": True}
"""Kind of masks -> whether they are predicted (`--fast`)."""
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
    "reconstruction": lambda shot: reconstruct(shot).result.views,
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
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {
                "kind": "v4l2",
                "height": height,
                "width": width,
                "format": "Y12",
                "black_level_dn": 64.0,
                "full_well_e": 10700.0,
                "electrons_per_dn": 2.7,
            },
            "stage": {"kind": "zaber"},
            "registration": {"superpixel": 2},
            "capture": {"masks": 8, "mask_s": MASKS_S, "seed": seed, "axis": "x", "from_mm": 73.0, "to_mm": 77.0},
            "optics": {"full_scale_e_per_s": 1e5},
            "world": {
                "scene": "planes",
                "devices": "ideal",
                "seed": seed,
                "height": height,
                "width": width,
                "scene_units_per_mm": 0.02,
                "flat_radiance": 0.8,
                "effects": {name: dict(told) for name, told in effects.items()},
            },
        }
    )


def take(
    effects: Mapping[str, Mapping[str, float]],
    seed: int,
    size: tuple[int, int] = SIZE,
    modes: Mapping[str, bool] = MODES,
) -> Case:
    """Calibrate a bench, in each mode into a bundle of its own, and take one shot with each and one without.

    The stage repeats its motion and the scene stands still: the shots differ by their noise.
    """
    told = table(effects, seed, size)
    rig = Rig(told, told.model_dump_json(), Path(), build_bench(told))
    assert rig.bench is not None
    devices = rig.open()
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            bundles = {mode: _calibrate(rig, devices, folder / f"{mode}.cal.h5", fast) for mode, fast in modes.items()}
            operator_of(rig, print).please(Arrangement.SCENE, 0)
            shots = {"nominal": _capture(rig, devices, folder / "nominal.h5", None)}
            for mode, bundle in bundles.items():
                shots[mode] = _capture(rig, devices, folder / f"{mode}.h5", load(rig, devices, read_bundle(bundle)))
            shown = intended(rig, devices)[1].masks
    finally:
        devices.close()
    true = truth_of(rig.bench, BITS).masks(shown)
    intervals = rig.bench.world.exposures[-1].masks
    weights = np.array([(mask.end_s - mask.start_s) / MASKS_S for mask in intervals], np.float32)
    shots["true"] = replace(shots["calibrated"], masks=true, weights=weights).check()
    return Case(shots, {name: float(np.sqrt(np.mean(np.square(one.masks - true)))) for name, one in shots.items()})


def _calibrate(rig: Rig, devices: Devices, path: Path, fast: bool) -> Path:
    """Do what `gs2ci calibrate` does, step by step into a bundle."""
    bench = bench_of(rig, devices, operator_of(rig, print), fast=fast)
    known = Bundle()
    for step in STEPS:
        known = add_section(path, PROCEDURES[step](bench, known), provenance_of(rig, devices))
    return path


def _capture(rig: Rig, devices: Devices, path: Path, calibrated: Calibrated | None) -> Shot:
    """Do what `gs2ci capture` does."""
    return read_shot(record(rig, devices, prepare(rig, devices, calibrated), path, replace=True, progress=Silent()))


def score(shot: Shot, recover: Callable[[Shot], F32]) -> float:
    """Return the mean PSNR of the recovered views, in dB; NaN where nothing could be recovered."""
    assert shot.truth.views is not None
    try:
        return float(np.mean(psnr_per_view(recover(shot), shot.truth.views)))
    except GeometryError:
        return float("nan")


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
