"""The loss and the gain of a fit by keeping its lists of Gaussians for several iterations: whole reconstructions.

    python -m tests.benchmarks list_reuse

Each case is reconstructed with lists made anew in every iteration, and kept for several, from some seeds, in turns.
Printed are the PSNR of the views that are handed over and of the bare scene, the iteration at which held-out pixels
would end the fit, and the processor time of one iteration, looks included, relative to fresh lists with the same seed
(other load slows a clock on the wall, and this one hardly). All fits run their whole schedule here: that end comes
early or late by chance, and would hide what lists do. The rasteriser alone is timed by `python -m tests.benchmarks
rasteriser`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Silent
from gs2ci.core.run_figures import CurvePoint
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut, Watch
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings
from tests.tables.cases import Case

CASES = (Case("boxes", scene="boxes"), Case("motorcycle", scene="motorcycle"))
EVERY = (1, 4, 8)
SEEDS = range(4)


@dataclass(frozen=True)
class Outcome:
    """Of one reconstruction."""

    psnr_db: float
    scene_db: float
    would_end: int
    iteration_s: float


class _FitClock(Silent):
    """Remembers when the fit began, in processor time of all threads."""

    fit_began_s = 0.0

    def stage(self, name: str, total: int | None = None) -> None:
        if name == "fit":
            self.fit_began_s = time.process_time()


def run() -> None:
    """Reconstruct, and print a line for each."""
    print(f"{'case':12} seed  every  PSNR, dB  scene, dB  would end  time per iteration, relative")
    for case in CASES:
        found = {(every, seed): _reconstructed(case, every, seed) for seed in SEEDS for every in EVERY}
        for (every, seed), outcome in found.items():
            relative = outcome.iteration_s / found[1, seed].iteration_s
            print(
                f"{case.name:12} {seed:4}  {every:5}  {outcome.psnr_db:8.2f}  {outcome.scene_db:9.2f}"
                f"  {outcome.would_end:9}  {relative:.2f}",
                flush=True,
            )
        for every in EVERY:
            lost = [found[1, seed].psnr_db - found[every, seed].psnr_db for seed in SEEDS]
            print(f"{case.name:12} lost  {every:5}  {np.mean(lost):8.2f} ± {np.std(lost):.2f}", flush=True)


def _reconstructed(case: Case, every: int, seed: int) -> Outcome:
    shot = case.shot(seed)
    truth = shot.truth.views
    assert truth is not None
    fit = CoarseSettings(hold_out=HoldOut(patience=CoarseSettings.iterations))
    settings = Settings(fit=fit, fits=1, seed=seed, raster=RasterSettings(relist_every=every))
    clock = _FitClock()
    result = reconstruct(shot, settings, clock).result
    per_iteration_s = (time.process_time() - clock.fit_began_s) / result.curve[-1].iteration
    psnr_db, scene_db = (_psnr_db(views, truth) for views in (result.views, result.scene_views))
    return Outcome(psnr_db, scene_db, _would_end(result.curve), per_iteration_s)


def _would_end(curve: Sequence[CurvePoint]) -> int:
    watch = Watch(HoldOut())
    for point in curve:
        watch.note(point.heldout, point.iteration)
        if watch.stalled(point.iteration):
            break
    return point.iteration


def _psnr_db(views: F32, truth: F32) -> float:
    return float(np.mean(psnr_per_view(views, truth)))
