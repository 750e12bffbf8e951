"""Accuracy of registration and masks: errors over random simulated benches, calibrated through their drivers.

python -m tests.benchmarks random_masks
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gs2ci.rig.config import RigTable
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES
from tests.bench_truth import opened
from tests.calibration.random_benches import BLACK_DN

BENCHES = 24
SIZE = (48, 64)


@dataclass(frozen=True)
class Outcome:
    """Errors of one bench, rms; and the share of values whose truth lies within two standard errors."""

    off_px: float
    map_within: float
    psf_within: float
    measured: float
    measured_within: float
    predicted: float
    predicted_within: float


def random_table(seed: int) -> RigTable:
    """Draw a bench: any way round, off by pixels, soft or sharp, of low or high contrast, coarse or fine readings."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, 41)))
    world: dict[str, Any] = {
        "scene": "planes",
        "height": SIZE[0],
        "width": SIZE[1],
        "seed": seed,
        "mirrored": bool(rng.integers(2)),
        "quarter_turns": int(rng.integers(4)),
        "lamp_drift_per_min": rng.uniform(-0.05, 0.05),
        "flat_radiance": 10 ** rng.uniform(-0.6, 0.4),
        "sensor": {"electrons_per_dn": rng.uniform(1.2, 4.0), "read_noise_e": rng.uniform(2.0, 8.0)},
        "effects": {
            "prnu": {"spread": rng.uniform(0.003, 0.02)},
            "dsnu": {"sigma_e": rng.uniform(0.5, 6.0)},
            "dark_current": {"current_e_per_s": rng.uniform(0.5, 30.0)},
            "vignetting": {"exponent": rng.uniform(0.0, 4.0)},
            "finite_contrast": {"contrast": float(np.exp(rng.uniform(np.log(5), np.log(200))))},
            "modulator_psf": {"sigma_px": rng.uniform(0.0, 1.0), "diffraction": bool(rng.integers(2))},
            "misregistration": {
                "right_px": rng.uniform(-3, 3),
                "down_px": rng.uniform(-3, 3),
                "turn_mrad": rng.uniform(-15, 15),
                "magnification": rng.uniform(0.985, 1.015),
            },
        },
    }
    return RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2", "format": rng.choice(["Y10", "Y12"]), "black_level_dn": BLACK_DN},
            "capture": {"masks": 4, "density": 0.5, "mask_s": 0.004, "seed": seed},
            "registration": {"superpixel": int(rng.integers(1, 4))},
            "optics": {"full_scale_e_per_s": 2e6},
            "calibration": {"frames": 16, "mask_frames": 4, "orientation": "any"},
            "world": world,
        }
    )


def calibrate(seed: int) -> Outcome:
    """Calibrate a random bench both ways and hold it against its truth."""
    with opened(random_table(seed)) as (bench, truth):
        known = Bundle()
        for step in ("dark-flat", "registration"):
            known = known.with_section(PROCEDURES[step](bench, known))
        masks = [PROCEDURES["masks"](replace(bench, fast=fast), known).estimates["masks"] for fast in (False, True)]
        true_masks = truth.masks(np.asarray(bench.capture.masks))
        affine, psf = (
            known.sections["registration"].estimates[key] for key in ("sensor_from_modulator", "psf_sigma_px")
        )
        points = (np.mgrid[: SIZE[0], : SIZE[1]] + 0.5).reshape(2, -1)[::-1]
        true = truth.sensor_from_modulator
        back = affine.value[:, :2] @ np.linalg.solve(true[:, :2], points - true[:, 2:]) + affine.value[:, 2:]
        figures = []
        for one in masks:
            figures += [
                float(np.sqrt(np.mean(np.square(one.value - true_masks)))),
                float(one.agrees(true_masks).mean()),
            ]
        return Outcome(
            float(np.sqrt(np.square(back - points).sum(axis=0).mean())),
            float(affine.agrees(true).mean()),
            float(psf.agrees(truth.psf_sigma_px)),
            *figures,
        )


def run() -> None:
    """Calibrate the benches and print errors and how true their stated errors are."""
    print(f"{'bench':>5} {'map, px':>9} {'measured':>9} {'predicted':>9}   errors rms")
    found = []
    for seed in range(BENCHES):
        one = calibrate(seed)
        found.append(one)
        print(f"{seed:>5} {one.off_px:>9.5f} {one.measured:>9.3%} {one.predicted:>9.3%}", flush=True)
    worst = {key: max(getattr(one, key) for one in found) for key in ("off_px", "measured", "predicted")}
    print(f"{'worst':>5} {worst['off_px']:>9.5f} {worst['measured']:>9.3%} {worst['predicted']:>9.3%}")
    print("truth within two standard errors:")
    for key in ("map_within", "psf_within", "measured_within", "predicted_within"):
        print(f"  {key.removesuffix('_within'):<10} {np.mean([getattr(one, key) for one in found]):.3f}")


if __name__ == "__main__":
    run()
