"""Random simulated benches of known truth, good ones and spoiled ones, for proving calibration on them.

Here: rig tables drawn from a seed, what must be refused why, and estimates held against the truth. Not here: the truth
itself, and opening a bench (`tests.bench_truth`), calibrating. Nothing here is a test.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from gs2ci.rig.config import RigTable
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.refusals import Reason
from tests.bench_truth import BenchTruth

BITS: Final = 12
BLACK_DN: Final = 64.0
TRUE_NAMES: Final = {"dark_noise_rms_dn": "dark_noise_dn"}

SPOILED: Final[Mapping[str, tuple[str, Reason, Mapping[str, Mapping[str, Any]]]]] = {
    "lens cap on": ("dark-flat", Reason.NO_LIGHT, {"world": {"always": "dark"}}),
    "lens cap off": ("dark-flat", Reason.NOT_DARK, {"world": {"always": "flat"}}),
    "scene instead of cap": ("dark-flat", Reason.NOT_DARK, {"world": {"always": "scene"}}),
    "saturated flat": ("dark-flat", Reason.SATURATED, {"world": {"flat_radiance": 3000.0}}),
    "lamp drifts": ("dark-flat", Reason.LAMP_DRIFTS, {"world": {"lamp_drift_per_min": 1.0, "flat_radiance": 0.1}}),
    "lamp flickers": (
        "dark-flat",
        Reason.LAMP_FLICKERS,
        {"world": {"flat_radiance": 4.0, "effects": {"illumination_flicker": {"depth": 0.6}}}},
    ),
    "field falls off": (
        "dark-flat",
        Reason.UNEVEN,
        {"world": {"effects": {"vignetting": {"exponent": 25.0}}}},
    ),
    "noise below rounding": (
        "dark-flat",
        Reason.NO_VARIANCE,
        {"sensor": {"format": "GREY"}, "world": {"sensor": {"read_noise_e": 0.0}, "effects": {}}},
    ),
    "black level at 0": ("dark-flat", Reason.CLIPPED_AT_BLACK, {"sensor": {"black_level_dn": 0.0}}),
    "hot sensor": (
        "dark-flat",
        Reason.DEAD_PIXELS,
        {"world": {"effects": {"hot_pixels": {"share": 0.1, "mean_e_per_s": 3000.0}}}},
    ),
    "dead pixels": ("dark-flat", Reason.DEAD_PIXELS, {"world": {"effects": {"prnu": {"spread": 0.5}}}}),
    "tone curve": ("sensor", Reason.NOT_LINEAR, {"world": {"effects": {"gain_nonlinearity": {"departure": 0.12}}}}),
    "dim lamp": ("sensor", Reason.NO_LIGHT, {"world": {"flat_radiance": 0.02}}),
}
"""What is wrong -> the step that must refuse it, why, and how the rig differs from a good one."""


def random_table(seed: int, *, size: tuple[int, int] = (32, 48), frames: int = 16) -> RigTable:
    """Draw a bench: sensor, defects, light and timing within what is common.

    Args:
        seed: Of the bench and of its noise.
        size: The sensor's height and width.
        frames: Of the dark and flat stacks.
    """
    rng = np.random.default_rng(np.random.SeedSequence((seed, 1288)))
    jitter_s = float(rng.choice([0.0, 1e-6, 3e-6]))
    return RigTable.model_validate(
        {
            "name": f"random bench {seed}",
            "modulator": {"kind": "scpi"},
            "sensor": {
                "kind": "v4l2",
                "height": size[0],
                "width": size[1],
                "format": "Y12",
                "black_level_dn": BLACK_DN,
            },
            "capture": {"masks": 4},
            "calibration": {"frames": frames},
            "world": {
                "scene": "planes",
                "height": size[0],
                "width": size[1],
                "seed": seed,
                "flat_radiance": rng.uniform(2.0, 5.0),
                "lamp_drift_per_min": rng.uniform(-0.005, 0.005),
                "trigger_latency_s": rng.uniform(0.0, 60e-6) + 3 * jitter_s,
                "trigger_jitter_s": jitter_s,
                "trigger_exposure_offset_s": rng.uniform(-20e-6, 40e-6),
                "sensor": {
                    "electrons_per_dn": rng.uniform(1.2, 4.0),
                    "read_noise_e": rng.uniform(2.0, 8.0),
                    "full_well_e": rng.uniform(4000.0, 14000.0),
                },
                "effects": {
                    "prnu": {"spread": rng.uniform(0.003, 0.02)},
                    "dsnu": {"sigma_e": rng.uniform(0.5, 6.0)},
                    "dark_current": {"current_e_per_s": rng.uniform(0.5, 60.0)},
                    "hot_pixels": {"share": 0.003, "mean_e_per_s": rng.uniform(500.0, 5000.0)},
                    "gain_nonlinearity": {"departure": rng.uniform(-0.01, 0.01)},
                    "vignetting": {"exponent": rng.uniform(0.0, 6.0)},
                },
            },
        }
    )


def spoiled_table(what: str, seed: int, **options: Any) -> RigTable:
    """Draw a bench as `random_table` does and spoil it in one of the ways of `SPOILED`."""
    return RigTable.model_validate(_merged(random_table(seed, **options).model_dump(), SPOILED[what][2]))


@dataclass(frozen=True)
class Compared:
    """One estimate held against the truth.

    Args:
        name: Of the estimate.
        value: It, or the rms of an array.
        error: Estimate minus truth, or its rms over an array.
        within: Share of values whose truth lies within two standard errors.
    """

    name: str
    value: float
    error: float
    within: float


def compare(section: Section, truth: BenchTruth) -> list[Compared]:
    """Hold those estimates of a section against the truth that a bench knows by the same name; dead pixels left out."""
    compared = []
    for name, estimate in section.estimates.items():
        true = getattr(truth, TRUE_NAMES.get(name, name), None)
        if true is None:
            continue
        live = section.array("dead") == 0 if "dead" in section.arrays and estimate.value.ndim else ...
        off = (estimate.value - true)[live]
        within = float(estimate.agrees(true)[live].mean())
        if estimate.value.ndim:
            value, error = float(np.sqrt(np.square(estimate.value).mean())), float(np.sqrt(np.square(off).mean()))
        else:
            value, error = float(estimate), float(off)
        compared.append(Compared(name, value, error, within))
    return compared


def _merged(table: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    same = {key for key, value in changes.items() if isinstance(table.get(key), dict) and "kind" not in value}
    both = {key: _merged(table[key], changes[key]) for key in same}
    return {**table, **changes, **both}
