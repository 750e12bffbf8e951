"""How well the stated error of the first camera path predicts the true one, on scenes with a known path.

    python -m tests.benchmarks path_error

Two tables: scenes of the simulator's library, three seeds each, and others with other masks, light, noise, sizes and
numbers of views. Printed are both errors as shares of the path's extent and the error of rotations; below each table
the factor of true over stated (median and range), the rank correlation (Spearman), how many paths are doubted aloud,
and both errors in the geometric mean, to compare ways of finding a path.
"""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
from scipy.stats import gmean, spearmanr

from gs2ci.reconstruct.geometry.path.validity import Criteria
from tests.tables.cases import Case
from tests.tables.works import initialise_case

SCENES = ("ball", "boxes", "corridor", "motorcycle", "planes", "textureless", "thicket")
FIRST = [(Case(name, scene=name), seed) for name in SCENES for seed in range(3)]
OTHERS = [
    *((Case(name, scene=name), seed) for name in SCENES for seed in (4, 5)),
    *((Case("moving", scene="moving"), seed) for seed in (0, 1)),
    *((Case(f"{name}, 16 views", scene=name, views=16), 3) for name in ("boxes", "corridor", "textureless")),
    *((Case(f"{name}, dim", scene=name, full_scale_photons=300.0), 3) for name in ("boxes", "thicket")),
    *((Case(f"{name}, noise", scene=name, noise=0.05), 8) for name in ("boxes", "textureless")),
    (Case("boxes, no focal", scene="boxes", focal_known=False), 6),
    (Case("motorcycle, large", scene="motorcycle", size=(272, 400)), 7),
]


def run() -> None:
    """Find the first geometries and print both tables."""
    for name, cases in (("first", FIRST), ("others", OTHERS)):
        print(f"{name:22} seed    true  stated  rotation, °")
        _table(cases)


def _table(cases: Sequence[tuple[Case, int]]) -> None:
    rows = []
    for case, seed in cases:
        row = initialise_case(asdict(case), "default", seed)
        true, stated = row["nate"], row["path_error_expected"]
        if stated is None:
            print(f"{case.name:22} {seed:4}  {row['verdict']}", flush=True)
            continue
        rows.append((true, stated, row["rpe_r_deg"]))
        print(f"{case.name:22} {seed:4}  {true:.4f}  {stated:.4f}  {row['rpe_r_deg']:.3f}", flush=True)
    true, stated, rotation_deg = np.array(rows).T
    ratio, limit = true / stated, Criteria().path_error
    aloud, wrong = stated > limit, true > limit
    print(
        f"{len(rows)} paths: true / stated {np.median(ratio):.2f} ({ratio.min():.2f} to {ratio.max():.2f}), rank "
        f"correlation {spearmanr(true, stated).statistic:.2f}; {(aloud & wrong).sum()} of {wrong.sum()} that err by "
        f"more than {limit:.0%} are doubted, and {(aloud & ~wrong).sum()} of the other {(~wrong).sum()}\n"
        f"geometric means: path {gmean(true):.4f}, rotation {gmean(rotation_deg):.3f}°\n"
    )
