"""The paper's whole schedule, 20,000 iterations, with every density rule and three seeds: does a number diverge?

    python -m tests.benchmarks long_fits

Prints for each fit whether all iterations were done without a rollback, whether all is finite, the population,
and the PSNR against the true views. The scene is small, so that a fit takes minutes.
"""

from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.choices import RULE_NAMES
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.paper.preset import paper_settings
from gs2ci.reconstruct.pipeline import reconstruct
from tests.tables.cases import Case

CASE = Case("boxes", scene="boxes", size=(32, 40))
SEEDS = range(3)


def _psnr_db(views: F32, truth: F32) -> float:
    return float(np.mean(psnr_per_view(views, truth)))


def run() -> None:
    """Fit, and print a line for each fit."""
    print(f"{'rule':8} seed  iterations  went back  finite  Gaussians  PSNR, dB      s")
    for name in RULE_NAMES:
        for seed in SEEDS:
            settings = replace(paper_settings(), seed=seed)
            settings = replace(settings, fit=with_rule(settings.fit, name))
            shot = CASE.shot(seed)
            found = reconstruct(shot, settings)
            result, truth = found.result, shot.truth.views
            assert truth is not None
            values = [*found.scene.parameters().values()]
            finite = all(bool(tensor.isfinite().all()) for tensor in values) and bool(np.isfinite(result.views).all())
            went_back = sum("back to iteration" in note.sentence for note in result.notes)
            print(
                f"{name:8} {seed:4}  {result.curve[-1].iteration:10}  {went_back:9}  {'yes' if finite else 'NO':6}"
                f"  {result.gaussians:9}  {_psnr_db(result.scene_views, truth):8.2f}  {result.seconds['total']:6.1f}",
                flush=True,
            )
