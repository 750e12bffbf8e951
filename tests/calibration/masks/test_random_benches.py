from dataclasses import dataclass, replace

import numpy as np
import pytest

from gs2ci_calibration.masks.masks_step import measure_masks
from gs2ci_calibration.masks.registration_step import measure_registration

WAYS = 8
BENCHES = 2 * WAYS


@dataclass
class Outcome:
    off_px: float
    map_agrees: np.ndarray
    psf_agrees: bool
    measured_rms: float
    measured_agrees: float
    predicted_rms: float
    predicted_agrees: float


def draw(seed):
    """Draw a bench: any way round, off by pixels, blurred or not, bright or dim, coarse or fine readings."""
    rng = np.random.default_rng(1000 + seed)
    bits, full_well_e = int(rng.choice([8, 10, 12])), float(rng.choice([5e3, 1e4, 3e4]))
    return {
        "seed": seed,
        "superpixel": int(rng.integers(1, 4)),
        "mirrored": bool(seed % WAYS >= WAYS // 2),
        "quarter_turns": seed % 4,
        "right_px": rng.uniform(-3, 3),
        "down_px": rng.uniform(-3, 3),
        "turn_mrad": rng.uniform(-15, 15),
        "magnification": rng.uniform(0.985, 1.015),
        "sigma_px": rng.uniform(0, 1),
        "contrast": float(np.exp(rng.uniform(np.log(5), np.log(300)))),
        "electrons_per_s": 10 ** rng.uniform(4, 6),
        "bits": bits,
        "full_well_e": full_well_e,
        "electrons_per_dn": full_well_e / 2**bits,
        "read_noise_e": rng.uniform(2, 8),
        "drift_per_s": rng.uniform(-1e-3, 1e-3),
        "size": (48, 60) if rng.random() < 0.7 else (64, 50),
    }


def off_px(world, section):
    """Return by how much the map is off, rms over the sensor."""
    truth = world.registration.sensor_from_modulator(*world.size)
    found = section.array("sensor_from_modulator")
    y, x = np.mgrid[: world.size[0], : world.size[1]] + 0.5
    seen = np.tensordot(found[:, :2], np.stack(world.looks_at(x, y)), axes=1) + found[:, 2, None, None]
    assert truth.shape == found.shape
    return float(np.sqrt(np.square(seen - np.stack([x, y])).sum(axis=0).mean()))


@pytest.fixture(scope="module")
def outcomes(bench_of_truth, dark_known):
    found = []
    for seed in range(BENCHES):
        bench = bench_of_truth(options={"orientation": "any"}, **draw(seed))
        registration = measure_registration(bench, dark_known(bench))
        known = dark_known(bench).with_section(registration)
        truth = bench.world.masks(bench.capture.masks)
        results = []
        for fast in (False, True):
            one = replace(bench, fast=fast)
            masks = measure_masks(one, known).estimates["masks"]
            rms = float(np.sqrt(np.mean(np.square(masks.value - truth))))
            results += [rms, float(masks.agrees(truth).mean())]
        affine, psf = (registration.estimates[key] for key in ("sensor_from_modulator", "psf_sigma_px"))
        agrees = affine.agrees(bench.world.registration.sensor_from_modulator(*bench.size))
        close = bool(psf.agrees(bench.world.sigma_px))
        found.append(Outcome(off_px(bench.world, registration), agrees, close, *results))
    return found


def test_registration_is_right_to_a_hundredth_of_a_pixel_on_every_bench(outcomes):
    assert max(one.off_px for one in outcomes) < 0.01


def test_measured_masks_are_right_to_one_per_cent_rms_on_every_bench(outcomes):
    assert max(one.measured_rms for one in outcomes) < 0.01


def test_predicted_masks_are_right_to_two_per_cent_rms_on_every_bench(outcomes):
    assert max(one.predicted_rms for one in outcomes) < 0.02


def test_standard_errors_hold_the_truth_in_95_per_cent(outcomes):
    # Six numbers of each map are correlated, so that their share scatters by about 3 %.
    assert np.mean([one.map_agrees for one in outcomes]) > 0.88
    assert np.mean([one.psf_agrees for one in outcomes]) > 0.85
    assert 0.93 < np.mean([one.measured_agrees for one in outcomes]) < 0.97
    assert np.mean([one.predicted_agrees for one in outcomes]) > 0.93
