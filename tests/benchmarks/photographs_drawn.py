"""Photographs on planes, drawn anew: three arrangements, three seeds of masks and noise, 96 x 128 px.

    python -m tests.benchmarks photographs_drawn

Prints PSNR of delivered views, of the scene, half way between two views and one step beyond the path, and processor
seconds, row by row and in the mean.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_SEED` | shifts the seeds | 0 |
| `GS2CI_NOISE` | standard deviation of the noise, in full scales of one view | 0.01 |
| `GS2CI_ITERATIONS` | the length of the schedule | that of `standard` |
"""

import os
import time
from dataclasses import replace

import numpy as np

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.novel_views import NovelViews
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import rescheduled
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.first_table import elsewhere_db
from tests.benchmarks.photographs import expose

SEEDS = range(11, 14)


def run() -> None:
    """Reconstruct each and print the table."""
    shift, rows, settings = int(os.environ.get("GS2CI_SEED", "0")), [], Settings()
    noise, iterations = float(os.environ.get("GS2CI_NOISE", "0.01")), os.environ.get("GS2CI_ITERATIONS")
    if iterations is not None:
        settings = replace(settings, fit=rescheduled(settings.fit, int(iterations)))
    print("| arrangement, seed | views | scene | between | beyond | processor s |\n|---|---:|---:|---:|---:|---:|")
    for seed in SEEDS:
        for which in range(3):
            shot, _, (images, poses) = expose(which, seed=10 * (seed + shift) + which, noise=noise, size=(96, 128))
            began_s = time.process_time()
            done = reconstruct(shot, settings)
            taken_s = time.process_time() - began_s
            truth, result = shot.truth.views, done.result
            scene = result.views if result.scene_views is None else result.scene_views
            assert truth is not None
            own = [float(np.mean(psnr_per_view(views, truth))) for views in (result.views, scene)]
            rows.append([*own, *map(float, elsewhere_db(done, shot, NovelViews(images, poses))), taken_s])
            print(f"| {which}, {seed + shift} | {' | '.join(f'{figure:.2f}' for figure in rows[-1])} |", flush=True)
    print(f"| mean | {' | '.join(f'{figure:.2f}' for figure in np.mean(rows, axis=0))} |")
