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

BENCHMARKS = (
    "first_table",
    "photographs_drawn",
    "rasteriser",
    "profile",
    "gpu_kernels",
    "gpu_model",
    "gpu_share",
    "gpu",
    "list_reuse",
    "harmonics",
    "beside_files",
    "mechanism_files",
    "design",
    "continuous",
    "grain",
    "video_out",
    "compiling",
    "endings",
    "small_matrices",
    "digests",
    "decoders",
    "video",
    "scaling",
    "sizes",
    "threads",
    "checkouts",
    "larger",
    "heldout_order",
    "mask_calibration",
    "random_masks",
    "even_masks",
    "disagreement",
    "bundle_adjustment",
    "path_error",
    "brightness",
    "no_motion",
    "stage_poses",
    "stage_interleavings",
    "disturbed_sweeps",
    "wide_motion",
    "ties",
    "exposures",
    "many_exposures",
    "photograph_paths",
    "photograph_rings",
    "given_poses",
    "depth",
    "lengths",
    "reliability",
    "displaced",
    "depth_order",
    "calibration_geometry",
    "calibrated_reconstruction",
    "calibration_base",
    "lens",
    "by_hand",
    "registration",
    "imports",
    "right_shots",
    "drawn_masks",
    "combination",
    "polish",
    "budgets",
    "motion_within_masks",
    "batch",
    "moving",
    "nonrigid",
    "processors",
    "long_fits",
    "population",
    "effect_bounds",
    "exact_renderer",
    "simulation_cost",
    "plan_deviation",
    "simulation_size",
    "own_model_class",
)

LONG = (
    "endings",
    "gpu",
    "photograph_rings",
    "ties",
    "exposures",
    "many_exposures",
    "photograph_paths",
    "motion_within_masks",
    "moving",
    "nonrigid",
    "checkouts",
    "larger",
    "batch",
    "processors",
    "profile",
    "design",
    "video",
    "stage_interleavings",
    "disturbed_sweeps",
    "depth",
    "lengths",
    "reliability",
    "first_table",
    "photographs_drawn",
    "list_reuse",
    "harmonics",
    "beside_files",
    "mechanism_files",
    "scaling",
    "digests",
    "heldout_order",
    "mask_calibration",
    "random_masks",
    "even_masks",
    "path_error",
    "no_motion",
    "depth_order",
    "calibration_geometry",
    "calibrated_reconstruction",
    "calibration_base",
    "registration",
    "imports",
    "combination",
    "polish",
    "budgets",
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
        importlib.import_module(f"tests.benchmarks.{name}").run()
    if not names:
        print(f"\nLeft out, as each takes long: {', '.join(LONG)}. Name those that you want.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
