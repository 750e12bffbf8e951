"""How does a fit change the poses of a stage? Exact ones should stay, poor ones should be improved.

    python -m tests.benchmarks given_poses

Scenes of the simulator's library, 128 × 96 px, one fit each. For places that err by a share of the path: how far the
fit moved them; the error of the path as given and after, as a share of its extent after a similarity; the mean PSNR.
Each with the prior, where tracks do not contradict the poses, and without any.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.processes import side_by_side
from tests.tables.case_sets import SIMULATED
from tests.tables.cases import Case

SIZE = (96, 128)
OFF = (0.0, 0.01, 0.05)
SEED = 0


def run() -> None:
    """Fit every scene with every report of a stage."""
    print(f"{'':28} {'moved, %':>15} {'path error, %':>22} {'PSNR, dB':>15}")
    print(f"{'':28} {'prior':>7} {'free':>7} {'given':>8} {'prior':>6} {'free':>6} {'prior':>7} {'free':>7}")
    for line in side_by_side(judge, list(_wanted())):
        print(line, flush=True)


def _wanted() -> Iterator[tuple[str, float]]:
    for scene in SIMULATED:
        for off in OFF:
            yield scene, off


def judge(wanted: tuple[str, float]) -> str:
    """Fit one scene with one report, with and without a prior; return its line of the table."""
    scene, off = wanted
    shot = Case(scene, scene=scene, size=SIZE, stage_off=off).shot(SEED)
    settings = Settings(poses="stage", fits=1, motion="off", look_again=False, seed=SEED)
    free = replace(settings, fit=replace(settings.fit, poses=replace(settings.fit.poses, given_weight=0.0)))
    results = [reconstruct(shot, one).result for one in (settings, free)]
    moved = " ".join(f"{100 * _moved(result):7.2f}" for result in results)
    errors = " ".join(f"{100 * _error(result.world_to_camera, shot):6.2f}" for result in results)
    psnr = " ".join(f"{_psnr_db(result, shot):7.2f}" for result in results)
    told = shot.telemetry_world_to_camera
    assert told is not None
    return f"{scene}, off by {100 * off:.0f} %".ljust(28) + f" {moved} {100 * _error(told, shot):8.2f} {errors} {psnr}"


def _moved(result: RunResult) -> float:
    moved = result.geometry.moved
    assert isinstance(moved, dict)
    return float(moved.share_of_path) if result.geometry.verdict == "full" else float("nan")


def _error(world_to_camera: F64, shot: Shot) -> float:
    assert shot.truth.world_to_camera is not None
    found = trajectory_errors(world_to_camera, shot.truth.world_to_camera).nate
    return float("nan") if found is None else found


def _psnr_db(result: RunResult, shot: Shot) -> float:
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(result.views, shot.truth.views)))
