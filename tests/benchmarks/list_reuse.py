"""What a fit loses and gains by keeping its lists of Gaussians for several iterations: whole reconstructions.

    python -m tests.benchmarks list_reuse

Each case is reconstructed with lists made anew in every iteration, and kept for several, from two seeds, in turns.
Printed are the PSNR of the views that are handed over and of the bare scene, the iterations until held-out pixels
ended the fit, and the seconds of one iteration, looks included, relative to those of fresh lists with the same seed.
The rasteriser alone is timed by `python -m tests.benchmarks rasteriser`.
"""

from dataclasses import dataclass

import numpy as np

from gs2ci.bench.cases import Case
from gs2ci.core.records import F32
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.pipeline import Settings, reconstruct
from gs2ci.render.settings import RasterSettings

CASES = (Case("boxes", scene="boxes"), Case("motorcycle", scene="motorcycle"))
EVERY = (1, 4, 8)
SEEDS = range(2)


@dataclass(frozen=True)
class Outcome:
    """Of one reconstruction."""

    psnr_db: float
    scene_db: float
    iterations: int
    iteration_s: float


def run() -> None:
    """Reconstruct, and print a line for each."""
    print(f"{'case':12} seed  every  PSNR, dB  scene, dB  iterations  s per iteration, relative")
    for case in CASES:
        found = {(every, seed): _reconstructed(case, every, seed) for seed in SEEDS for every in EVERY}
        for (every, seed), outcome in found.items():
            relative = outcome.iteration_s / found[1, seed].iteration_s
            print(
                f"{case.name:12} {seed:4}  {every:5}  {outcome.psnr_db:8.2f}  {outcome.scene_db:9.2f}"
                f"  {outcome.iterations:10}  {relative:.2f}",
                flush=True,
            )
        for every in EVERY:
            quality = [outcome.psnr_db for (used, _), outcome in found.items() if used == every]
            print(f"{case.name:12} mean  {every:5}  {np.mean(quality):8.2f} ± {np.ptp(quality) / 2:.2f}", flush=True)


def _reconstructed(case: Case, every: int, seed: int) -> Outcome:
    shot = case.shot(seed)
    truth = shot.truth.views
    assert truth is not None
    result = reconstruct(shot, Settings(seed=seed, raster=RasterSettings(relist_every=every))).result
    iterations = result.curve[-1].iteration
    return Outcome(
        _psnr_db(result.views, truth),
        _psnr_db(result.scene_views, truth),
        iterations,
        result.seconds["fit"] / iterations,
    )


def _psnr_db(views: F32, truth: F32) -> float:
    return float(np.mean(psnr_per_view(views, truth)))
