"""`make benchmarks`: run the benchmarks and print their figures. Nothing is asserted: timings belong to a machine.

    python -m tests.benchmarks            all that take minutes
    python -m tests.benchmarks long_fits  any by name, also those of `LONG`

A benchmark is one file with a function `run()` that prints its figures, and one line in `BENCHMARKS`.
"""

import importlib
import platform
import sys
from collections.abc import Sequence

import numba
import numpy as np
import torch

BENCHMARKS = {
    "first_table": "tests.benchmarks.first_table",
    "rasteriser": "tests.benchmarks.rasteriser",
    "profile": "tests.benchmarks.profile",
    "list_reuse": "tests.benchmarks.list_reuse",
    "harmonics": "tests.benchmarks.harmonics",
    "beside_files": "tests.benchmarks.beside_files",
    "simulated_capture": "tests.benchmarks.simulated_capture",
    "continuous": "tests.benchmarks.continuous",
    "video_out": "tests.benchmarks.video_out",
    "proxies": "tests.benchmarks.proxies",
    "small_matrices": "tests.benchmarks.small_matrices",
    "digests": "tests.benchmarks.digests",
    "decoders": "tests.benchmarks.decoders",
    "video": "tests.benchmarks.video",
    "scaling": "tests.benchmarks.scaling",
    "sizes": "tests.benchmarks.sizes",
    "checkouts": "tests.benchmarks.checkouts",
    "heldout_order": "tests.benchmarks.heldout_order",
    "mask_calibration": "tests.benchmarks.mask_calibration",
    "random_masks": "tests.benchmarks.random_masks",
    "disagreement": "tests.benchmarks.disagreement",
    "bundle_adjustment": "tests.benchmarks.bundle_adjustment",
    "path_error": "tests.benchmarks.path_error",
    "brightness": "tests.benchmarks.brightness",
    "no_motion": "tests.benchmarks.no_motion",
    "stage_poses": "tests.benchmarks.stage_poses",
    "wide_motion": "tests.benchmarks.wide_motion",
    "told_poses": "tests.benchmarks.told_poses",
    "depth": "tests.benchmarks.depth",
    "lengths": "tests.benchmarks.lengths",
    "direct": "tests.benchmarks.direct",
    "depth_order": "tests.benchmarks.depth_order",
    "calibration_geometry": "tests.benchmarks.calibration_geometry",
    "calibrated_reconstruction": "tests.benchmarks.calibrated_reconstruction",
    "calibration_base": "tests.benchmarks.calibration_base",
    "lens": "tests.benchmarks.lens",
    "by_hand": "tests.benchmarks.by_hand",
    "registration": "tests.benchmarks.registration",
    "right_shots": "tests.benchmarks.right_shots",
    "drawn_masks": "tests.benchmarks.drawn_masks",
    "combination": "tests.benchmarks.combination",
    "polish": "tests.benchmarks.polish",
    "motion_within_masks": "tests.benchmarks.motion_within_masks",
    "batch": "tests.benchmarks.batch",
    "moving": "tests.benchmarks.moving",
    "nonrigid": "tests.benchmarks.nonrigid",
    "processors": "tests.benchmarks.processors",
    "long_fits": "tests.benchmarks.long_fits",
    "population": "tests.benchmarks.population",
    "effect_bounds": "tests.benchmarks.effect_bounds",
    "exact_renderer": "tests.benchmarks.exact_renderer",
    "simulation_cost": "tests.benchmarks.simulation_cost",
    "plan_deviation": "tests.benchmarks.plan_deviation",
    "simulation_size": "tests.benchmarks.simulation_size",
    "own_model_class": "tests.benchmarks.own_model_class",
}

LONG = (
    "motion_within_masks",
    "moving",
    "nonrigid",
    "checkouts",
    "batch",
    "processors",
    "profile",
    "video",
    "depth",
    "lengths",
    "first_table",
    "list_reuse",
    "harmonics",
    "beside_files",
    "scaling",
    "digests",
    "heldout_order",
    "mask_calibration",
    "random_masks",
    "path_error",
    "no_motion",
    "depth_order",
    "calibration_geometry",
    "calibrated_reconstruction",
    "calibration_base",
    "registration",
    "combination",
    "polish",
    "long_fits",
    "population",
    "effect_bounds",
    "simulation_cost",
    "plan_deviation",
    "simulation_size",
    "own_model_class",
    "video_out",
)
"""Many benches or whole schedules each: run only by name."""


def main(names: Sequence[str]) -> int:
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    print(
        f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, "
        f"torch {torch.__version__}, numba {numba.__version__}, numpy {np.__version__}"
    )
    for name in names or [name for name in BENCHMARKS if name not in LONG]:
        print(f"\n== {name}")
        importlib.import_module(BENCHMARKS[name]).run()
    if not names:
        print(f"\nLeft out, as each takes long: {', '.join(LONG)}. Name those that you want.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
