"""The cost of mask calibration: simulated benches of known truth, calibrated through their drivers.

Here: the benches, opening one, and the work of one cell. Not here: the table (`catalogue`), the calibration
(`gs2ci_calibration`).
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.rig.calibrating import bench_of, operator_of
from gs2ci.rig.config import RigTable
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import SimulatedBench, build_bench
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES

SIZE: Final = (64, 96)
MASKS: Final = 8
FRAMES: Final = (2, 8, 32)
LOOSE: Final = 0.4
"""A wanted accuracy that asks for no more frames than are named."""
SHARP: Final = {"modulator_psf": {"sigma_px": 0.35, "diffraction": False}, "finite_contrast": {}}
MOVED: Final = {"misregistration": {"right_px": 1.4, "down_px": -0.7, "turn_mrad": 6.0, "magnification": 1.004}}
BENCHES: Final[Mapping[str, Mapping[str, Any]]] = {
    "sharp": {"effects": SHARP | MOVED},
    "dim": {"effects": SHARP | MOVED, "flat_radiance": 0.05},
    "soft, low contrast": {
        "effects": {
            "modulator_psf": {"sigma_px": 0.9, "diffraction": False},
            "finite_contrast": {"contrast": 6.0},
            "misregistration": {"right_px": -0.6, "down_px": 2.3, "turn_mrad": -3.0},
        }
    },
    "drifting lamp": {"effects": SHARP | MOVED, "lamp_drift_per_min": 0.1},
}
"""Name of a bench -> its [world], beyond what all have."""


def calibrate_masks(bench: str, frames: int, fast: bool, seed: int) -> Row:
    """Calibrate a bench from dark frames to masks; return figures against its truth.

    Args:
        bench: A name in `BENCHES`.
        frames: Of each mask, and of each pattern of the registration; of the registration alone when `fast`.
        fast: Whether masks are predicted.
        seed: Of the bench and its masks.

    Returns:
        Errors of masks in per cent, of the registration in pixels; the bench's seconds, upload included, of the steps
        masks (without slot weights, which are the same in both modes) and registration.

    Raises:
        Gs2ciError: The bench is unknown, or its calibration refused.
    """
    with opened(_table(bench, frames, seed)) as (drawn, simulated):
        one = replace(drawn, fast=fast)
        known = Bundle()
        for step in ("dark-flat", "registration", "masks"):
            known = known.with_section(PROCEDURES[step](one, known))
        light = simulated.light
        assert light is not None  # the table has a scene
        off = known.sections["masks"].array("masks") - light.true_masks(np.asarray(one.capture.masks), 1)
        true_map = light.registration.sensor_from_modulator(*light.scene.size)
    masks, registration = known.sections["masks"], known.sections["registration"]
    return {
        "mask_error_pct": 100 * float(np.sqrt(np.mean(np.square(off, dtype=np.float64)))),
        "stated_pct": 100 * masks.estimates["masks"].error,
        "frames": int(masks.facts["frames"]),
        "seconds": float(masks.facts["seconds"] - masks.facts["slot_seconds"]),
        "registration_px": _off_px(registration.array("sensor_from_modulator"), true_map),
        "registration_seconds": float(registration.facts["seconds"]),
    }


@contextmanager
def opened(table: RigTable) -> Iterator[tuple[Bench, SimulatedBench]]:
    """Open a simulated bench for calibration; its devices are released afterwards."""
    rig = Rig(table, table.model_dump_json(), Path(), build_bench(table))
    assert rig.bench is not None  # it has just been built
    devices = rig.open()
    try:
        devices.sensor.connect()
        yield bench_of(rig, devices, operator_of(rig, str)), rig.bench
    finally:
        devices.close()


def _table(bench: str, frames: int, seed: int) -> RigTable:
    if bench not in BENCHES:
        raise InputError(f"bench {bench!r} is unknown", allowed=", ".join(BENCHES))
    height, width = SIZE
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "format": "Y12", "black_level_dn": 64.0},
            "capture": {"masks": MASKS, "density": 0.5, "mask_s": 0.01, "seed": seed},
            "registration": {"superpixel": 2},
            "optics": {"full_scale_e_per_s": 1e6},
            "calibration": {"mask_frames": frames, "mask_accuracy": LOOSE},
            "world": {
                "scene": "planes",
                "height": height,
                "width": width,
                "seed": seed,
                "devices": "ideal",  # but for what the bench is named after
            }
            | dict(BENCHES[bench]),
        }
    )


def _off_px(found: F64, truth: F64) -> float:
    """Return by how much a map is off, rms over the sensor."""
    points = (np.mgrid[: SIZE[0], : SIZE[1]] + 0.5).reshape(2, -1)[::-1]
    modulator = np.linalg.solve(truth[:, :2], points - truth[:, 2:])
    return float(np.sqrt(np.square(found[:, :2] @ modulator + found[:, 2:] - points).sum(axis=0).mean()))
