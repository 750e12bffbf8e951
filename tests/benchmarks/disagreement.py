"""The correlation of two fits' disagreement with their error: scenes of the simulator's library with known truth.

    python -m tests.benchmarks disagreement

Pixels are sorted into fifths by disagreement. It prints the root-mean-square error of the views in each fifth, and the
rank correlation (Spearman) of disagreement and error over pixels.
"""

import numpy as np
from scipy.stats import spearmanr

from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.tables.case_sets import simulated_cases

FIFTHS = 5
SEED = 0


def run() -> None:
    """Reconstruct each scene and print a line for it."""
    print(f"{'scene':12} error, rms, from the fifth that agrees best to the one that agrees least    rank correlation")
    for case in simulated_cases():
        shot = case.shot(SEED)
        result, truth = reconstruct(shot, Settings(seed=SEED)).result, shot.truth.views
        assert truth is not None
        assert result.disagreement is not None
        disagreement = result.disagreement.ravel()
        error = np.sqrt(np.mean((result.views - truth) ** 2, axis=3)).ravel()
        parts = np.array_split(np.argsort(disagreement, kind="stable"), FIFTHS)
        errors = "  ".join(f"{np.sqrt(np.mean(error[part] ** 2)):.4f}" for part in parts)
        print(f"{case.name:12} {errors}    {spearmanr(disagreement, error).statistic:.2f}", flush=True)
