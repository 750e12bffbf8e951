"""Is the capture that `gs2ci design` chooses as good as the best of a grid, and at which share of its cost?

    python -m tests.benchmarks design

The simulated bench of docs/rigs/simulated.toml with a picture of 72 × 96 px and a travel of 6 mm, before two scenes
that no number of the foresight was set on (`GS2CI_SCENES="ball glossy"`). The grid: 4, 8 and 16 masks, 1/8, 1/4 and
1/2 open, travels of 4 and 12 mm. Each of its 18 candidates is exposed and reconstructed by the default preset, and
judged by the views of its scene along 6 mm. The design tries the same candidates with two checks by drafts
(`GS2CI_CHECKS=2`); what it chooses is looked up in the grid.

For each scene: rank correlation (Kendall's tau) of what is foreseen with the grid, the best of the grid, what was
chosen and by how much it is worse, processor seconds of both, and their ratio. Then a line for each candidate.
"""

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import kendalltau

from gs2ci.api.designing import design
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.progress import Silent
from gs2ci.evaluate.design.checking import checked
from gs2ci.evaluate.design.pages import DesignRow
from gs2ci.evaluate.novel_views import NovelViews
from gs2ci.rig.config import read_rig
from gs2ci.rig.design.candidates import CaptureCandidate, Varied
from gs2ci.rig.design.exposing import small_bench
from gs2ci.rig.design.rewriting import with_capture
from gs2ci.rig.design.telling import wanted_views

SIZE: Final = (72, 96)
MASKS, OPEN, TRAVELS_MM = (4, 8, 16), (0.125, 0.25, 0.5), (4.0, 12.0)
RIG: Final = Path(__file__).resolve().parents[2] / "docs" / "rigs" / "simulated.toml"
SEED: Final = 42


def run() -> None:
    """Print the comparison for each scene."""
    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.toml"
        text = RIG.read_text(encoding="utf-8")
        # Half as much light as in the file, so that no candidate is left out, in an exposure in which the stage can go
        # 12 mm.
        text = text.replace("full_scale_e_per_s = 100000.0", "full_scale_e_per_s = 20000.0")
        capture = {"mask_s": 0.05, "from_mm": 72.0, "to_mm": 78.0, "shots": 1}
        rig.write_text(with_capture(text, capture), encoding="utf-8")
        for scene in os.environ.get("GS2CI_SCENES", "ball glossy").split():
            _compare(rig, scene)


def _compare(rig: Path, scene: str) -> None:
    grid, grid_s = _grid(rig, scene)
    began_s = time.process_time()
    found = design(
        rig,
        rig.with_name(f"{scene}.toml"),
        scene=scene,
        masks=MASKS,
        open_share=OPEN,
        element=(1,),
        travel_mm=TRAVELS_MM,
        exposures=(1,),
        checks=int(os.environ.get("GS2CI_CHECKS", "2")),
        size=SIZE,
        seed=SEED,
        progress=Silent(),
    ).found
    design_s = time.process_time() - began_s
    foreseen = [row.foreseen_db or 0.0 for row in found.rows]
    true = [grid[_candidate(row)] for row in found.rows]
    tau = kendalltau(foreseen, true).statistic
    best = max(grid, key=lambda one: grid[one])
    chosen = _candidate(found.chosen)
    print(f"{scene}: tau {tau:.2f}; best {grid[best]:.2f} dB, {best}")
    print(f"  chosen {grid[chosen]:.2f} dB ({grid[chosen] - grid[best]:+.2f}), {chosen}")
    print(f"  processor seconds: grid {grid_s:.0f}, design {design_s:.1f}, ratio {design_s / grid_s:.3f}")
    for row in found.ranked:
        one = _candidate(row)
        print(f"    {one}: foreseen {row.foreseen_db:.2f}, grid {grid[one]:.2f}", flush=True)


def _candidate(row: DesignRow) -> CaptureCandidate:
    return CaptureCandidate(row.masks, row.density, row.element, row.travel_mm, row.exposures)


def _grid(rig: Path, scene: str) -> tuple[dict[CaptureCandidate, float], float]:
    """Reconstruct every candidate; return the quality of each, dB, and the processor seconds of all."""
    began_s = time.process_time()
    table, _ = read_rig(rig)
    bench = small_bench(table, scene, SIZE)
    wanted = wanted_views(bench, table.capture, None)
    views = NovelViews(wanted.views, wanted.poses)
    found = {}
    for one in Varied(MASKS, OPEN, (1,), TRAVELS_MM, (1,)).candidates(table):
        capture = replace(one).capture(table.capture)
        shots = [bench.expose(capture, index) for index in range(one.exposures)]
        try:
            found[one] = checked(shots, views, bench.scene.intrinsics, "standard", SEED).psnr_db
        except Gs2ciError:
            found[one] = float(np.nan_to_num(-np.inf, neginf=0.0))
    return found, time.process_time() - began_s
