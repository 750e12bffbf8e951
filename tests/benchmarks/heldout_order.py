"""Do held-out pixels of the measurement rank reconstructions as the truth does? Counted on many scenes.

Each case is reconstructed in the same ways, from the decode alone to the longest schedule; each result is scored by
held-out pixels of the measurement and by the true views. It prints, per case, the rank correlation (Kendall's tau) of
both scores and the loss if the result with the best held-out score is chosen. The cases are scenes of the simulator's
library, exposed by its light path, and the files of `GS2CI_SHARED_DATA` if that is set. Finished results are kept in
`runs/heldout_order`.
"""

import os
import statistics
from dataclasses import asdict
from pathlib import Path

from gs2ci.evaluate.tradeoff.front import agreement
from gs2ci.evaluate.tradeoff.store import Row, Store
from gs2ci.evaluate.tradeoff.trials import TRIALS, tried
from tests.tables.case_sets import file_cases, resized, simulated_cases
from tests.tables.cases import Case
from tests.tables.cells import Cell
from tests.tables.workers import complete

NAMES = (
    "decode",
    "half the resolution",
    "100 iterations",
    "200 iterations",
    "draft",
    "0.1 Gaussians per pixel",
    "1 fit",
    "standard",
    "4 fits",
)
SIZE = (96, 128)
KEPT = Path("runs/heldout_order")


def tried_on_case(case: dict[str, object], trial: str, seed: int) -> Row:
    """Treat a case in one way; the work of a cell."""
    return tried(Case.of(case).shot(seed), TRIALS[trial], seed)


def run() -> None:
    cases = list(resized(simulated_cases(), SIZE))
    shared = os.environ.get("GS2CI_SHARED_DATA")
    cases += file_cases(Path(shared)) if shared else []
    taus, regrets = [], []
    print(f"{'case':24} {'tau':>6} {'lost, dB':>9} {'PSNR of all, dB':>18}")
    for case in cases:
        arguments = [{"case": asdict(case), "trial": name, "seed": 0} for name in NAMES]
        files = (case.file,) if case.file else ()
        cells = [Cell(tried_on_case, one, files) for one in arguments]
        rows = [row for row in complete(cells, Store(KEPT)) if "error" not in row]
        found = agreement(rows)
        if found is None or found.tau is None:
            print(f"{case.name:24}   nothing to compare")
            continue
        truth = [row["psnr_db"] for row in rows]
        print(f"{case.name:24} {found.tau:6.2f} {found.regret_db:9.2f} {min(truth):8.2f} … {max(truth):.2f}")
        taus.append(found.tau)
        regrets.append(found.regret_db)
    if taus:
        print(f"{'mean':24} {statistics.mean(taus):6.2f} {statistics.mean(regrets):9.2f}")
