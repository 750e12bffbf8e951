"""The share of a run's processor time that is spent on what has an implementation for a device, and what the rest is.

    python -m tests.benchmarks gpu_share
    GS2CI_PRESET=standard python -m tests.benchmarks gpu_share

One simulated exposure is reconstructed by `GS2CI_PRESET` (draft) at `GS2CI_SIZE` (240x320) on the CPU, every kernel on
one thread. The clock of the thread that runs a part counts what it costs, without what the parts inside it cost. That a
part has an implementation for a device means that it runs there where a device is used, not that it was ever timed on
one.
"""

import os
import time
from unittest.mock import patch

import numba

from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.decode import denoisers, pnp
from gs2ci.reconstruct.decode.patches import denoiser, matching
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthField, FieldStep
from gs2ci.reconstruct.fit.surfaces.surfaces import Surfaces
from gs2ci.reconstruct.geometry.depth import sweep
from gs2ci.reconstruct.measurement import brightness
from gs2ci.reconstruct.measurement.brightness import LinearSystem
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.uncertainty import estimate
from gs2ci.render.cpu import backend
from tests.benchmarks import profile
from tests.stability.benches import Bench

PRESET = os.environ.get("GS2CI_PRESET", "draft")
SIZE = tuple(int(side) for side in os.environ.get("GS2CI_SIZE", "240x320").split("x"))
MORE = (
    ("iteration: field of depth", DepthField, "step"),
    ("iteration: field of depth", FieldStep, "of_scene"),
    ("iteration: field of depth", Surfaces, "moved"),
    ("rendering: code of masks", backend.CpuBackend, "code"),
    ("sweeps: views compared, and smoothed", sweep, "_best_planes"),
    ("brightness of views", LinearSystem, "of"),
    ("brightness of views", LinearSystem, "solve"),
    ("brightness of views", LinearSystem, "errors"),
    ("brightness of views", LinearSystem, "gain"),
    ("brightness: sums over blocks", brightness, "block_numbers"),
    ("brightness: sums over blocks", brightness, "scores_over_blocks"),
    ("decode: GAP's projections", pnp, "project_onto_measurement"),
    ("decode: total variation", denoisers, "denoise_planes"),
    ("decode: checks of a step", pnp, "_checked"),
    ("decode: checks of a step", pnp, "_relative"),
    ("standard errors of depths", estimate, "errors_of_depths"),
    ("standard errors: the rest", pipeline, "how_sure"),
    ("patches: groups denoised", denoiser, "denoise_groups"),
    ("patches' search", matching, "match_patches"),
    ("patches' flow", denoiser.Flow, "between"),
    ("patches' colours and the rest", denoiser.SimilarPatches, "__call__"),
)
ON_DEVICE = (
    "iteration: loss",
    "iteration: opacity term",
    "iteration: surfaces' term",
    "iteration: finite",
    "iteration: Gaussians' step",
    "iteration: field of depth",
    "fit: error blended back",
    "rendering: code of masks",
    "standard errors of depths",
    "brightness of views",
    *("sweeps: ", "decode: ", "patches: "),
    "kernel: ",
    "depth of each Gaussian",
)


def run() -> None:
    """Print the share and the parts."""
    shot = Bench(scene=profile.SCENE).expose(SIZE)
    settings = preset(PRESET)  # type: ignore[arg-type]
    pipeline.reconstruct(Bench(scene=profile.SCENE).expose((48, 64)), settings)  # compiles
    threads, clock = numba.get_num_threads(), profile.Clock()
    try:
        numba.set_num_threads(1)
        with patch.object(profile, "PARTS", (*profile.PARTS, *MORE)), profile.counting(clock):
            began_s = time.process_time()
            found = pipeline.reconstruct(shot, settings)
            total_s = time.process_time() - began_s
    finally:
        numba.set_num_threads(threads)
    there_s = sum(seconds for name, seconds in clock.seconds.items() if name.startswith(ON_DEVICE))
    of_fit = {
        name: seconds
        for name, seconds in clock.seconds.items()
        if name.startswith(("fit: ", "iteration: ", "kernel: ", "sweeps: ", "rendering: "))
    }
    fit_s = sum(of_fit.values())
    fit_there_s = sum(seconds for name, seconds in of_fit.items() if name.startswith(ON_DEVICE))
    print(
        f"{profile.SCENE}, {SIZE[0]} x {SIZE[1]} x {shot.views}, {PRESET}: CPU {total_s:.1f} s, "
        f"{found.result.gaussians} Gaussians\n"
        f"has an implementation for a device: {there_s:.1f} s, {there_s / total_s:.1%} of all; of the fit and of all "
        f"rendering, {fit_there_s / fit_s:.1%}\n"
        f"{'part':36} {'CPU s':>7} {'share':>6}  on a device"
    )
    for name in sorted(clock.seconds, key=lambda part: -clock.seconds[part]):
        seconds, there = clock.seconds[name], "yes" if name.startswith(ON_DEVICE) else ""
        print(f"{name:36} {seconds:7.2f} {seconds / total_s:6.1%}  {there}")
    rest_s = total_s - sum(clock.seconds.values())
    print(f"{'what is left':36} {rest_s:7.2f} {rest_s / total_s:6.1%}")
