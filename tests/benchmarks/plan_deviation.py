"""Deviation of plans from full simulations: every rig of the simulator, masks that cancel or align, and a mesh.

    python -m tests.benchmarks plan_deviation

Each in three draws of masks and effects (`GS2CI_DRAWS`); full simulations are converged to a fifth of the tolerance.
`GS2CI_JOBS` sets the number of processes that share the cases (1), `GS2CI_CASES` names some of them. Times are
processor seconds.
"""

import multiprocessing
import os
import time

from tests.benchmarks.simulation_cases import SimulationCase, simulation_cases

SETTLED = 0.2
DRAWS = int(os.environ.get("GS2CI_DRAWS", "3"))
JOBS = int(os.environ.get("GS2CI_JOBS", "1"))


def _row(case: SimulationCase) -> tuple[bool, str]:
    began_s = time.process_time()
    found = []
    for seed in range(DRAWS):
        bench = case.bench(seed)
        decided, photons = bench.planned()
        settled = bench.everything(SETTLED * bench.tolerance_dn)
        found.append((bench.off_dn(settled, photons, decided), decided.error_dn, decided.views, settled.views))
    within = all(off <= case.tolerance_dn for off, *_ in found)
    offs = ", ".join(f"{off:.3f}" for off, *_ in found)
    bound = max(error for _, error, *_ in found)
    views, settled_views = (max(row[column] for row in found) for column in (2, 3))
    return within, (
        f"| {case.label} | {case.tolerance_dn:g} | {bound:.3f} | {offs} | {'yes' if within else 'NO'} "
        f"| {views} | {settled_views} | {time.process_time() - began_s:.0f} |"
    )


def run() -> None:
    """Print a row per case, and how many keep within their tolerance in every draw."""
    print("| case | tolerance, DN | bound, DN | off by, DN | within | views | views of everything | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    kept = 0
    cases = simulation_cases(idle=False)
    with multiprocessing.get_context("spawn").Pool(JOBS) as pool:
        for within, row in pool.imap(_row, cases):
            kept += within
            print(row, flush=True)
    print(f"{kept} of {len(cases)} within their tolerance in {DRAWS} draws each")
