"""Errors of the depth of reconstructions with default settings.

    python -m tests.benchmarks depth

Scenes of the simulator's library with 8 views, three seeds each and one of them with noise; photographs on planes, the
second arrangement in front of a nearly plain wall, whose texture hardly determines its depth; and, if `GS2CI_DATA`
names a folder that holds `lightfield/antinous.npz`, that path-traced light field with its true disparity from a
position between two cameras. It prints the views' PSNR, the path's error, and the figures of `gs2ci.evaluate.depth`:
the error relative to depth after one scale, and that of the disparity between neighbouring views, px, after the best
affine fit of inverse depths. The light field has no depth at the coded positions: its scene is rendered half way
between the recovered poses four and five.
"""

import os
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.evaluate.depth import DepthErrors, depth_errors, parallax_of
from gs2ci.evaluate.report import Report
from gs2ci.evaluate.run_report import build_report
from gs2ci.reconstruct.pipeline import Reconstruction, reconstruct
from gs2ci.render.backend import load_backend
from tests.benchmarks.photographs import expose
from tests.processes import side_by_side
from tests.tables.cases import Case

SIMULATED = [
    *((Case(name, scene=name, size=(144, 192)), seed) for name in ("boxes", "ball", "motorcycle") for seed in range(3)),
    (Case("boxes, noise", scene="boxes", size=(144, 192), noise=0.02), 0),
    (Case("corridor", scene="corridor", size=(144, 192)), 0),
]
# Arrangement, and how far the photograph behind the others is blurred.
PHOTOGRAPHS = [(2, 0.0), (1, 0.05)]
LIGHT_FIELD = Path(os.environ.get("GS2CI_DATA", "")) / "lightfield"


def run() -> None:
    """Reconstruct each and print a line for it."""
    print(f"{'':14} seed  {'PSNR':>6} {'nATE':>7}   depth")
    told = (LIGHT_FIELD / "antinous.npz").is_file()
    # The light field is the largest by far: it begins first, beside the others.
    tasks = [*([None] if told else []), *range(len(SIMULATED) + len(PHOTOGRAPHS))]
    for line in side_by_side(judge, tasks):
        print(line, flush=True)
    if not told:
        print("Left out, as GS2CI_DATA names no folder that holds it: the light field.")


def judge(number: int | None) -> str:
    """Reconstruct one of `SIMULATED` and `PHOTOGRAPHS`, or the light field if None, and return its line."""
    if number is None:
        shot = Case("antinous", file=str(LIGHT_FIELD / "antinous.npz")).shot(0)
        found = reconstruct(shot)
        return _line("antinous", 0, build_report(shot, found.result), between(found))
    if number >= len(SIMULATED):
        which, blur = PHOTOGRAPHS[number - len(SIMULATED)]
        shot, depth, _ = expose(which, 0, size=(144, 192), blur=blur)
        result = reconstruct(shot).result
        assert shot.truth is not None
        assert shot.truth.world_to_camera is not None
        errors = depth_errors(result.depth, depth, parallax_of(shot.truth.world_to_camera, result.intrinsics))
        assert errors is not None
        return _line(f"cards {which}{', plain' if blur else ''}", 0, build_report(shot, result), errors)
    case, seed = SIMULATED[number]
    shot = case.shot(seed)
    report = build_report(shot, reconstruct(shot).result)
    assert report.depth is not None
    return _line(case.name, seed, report, report.depth)


def between(found: Reconstruction) -> DepthErrors:
    """Score the scene against the light field's true disparity, from half way between the poses four and five."""
    disparity = np.load(LIGHT_FIELD / "antinous_between.npz")["disparity"].astype(np.float64)
    pose = half_way(*found.result.world_to_camera[3:5])
    light = load_backend().depths(
        found.scene,
        torch.from_numpy(pose)[None].float(),
        torch.from_numpy(found.result.intrinsics).float(),
        (disparity.shape[0], disparity.shape[1]),
    )
    # Disparity is inverse depth in px: at a depth of 1 it is 1.
    errors = depth_errors(light.surface().numpy(), (1 / disparity).astype(np.float32), parallax=1.0)
    assert errors is not None
    return errors


def half_way(one: F64, other: F64) -> F64:
    """Return the pose half way between two, [4, 4]."""
    turn = Slerp([0, 1], Rotation.from_matrix(np.stack([one[:3, :3], other[:3, :3]])))(0.5).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = -turn @ camera_centres(np.stack([one, other])).mean(axis=0)
    return pose


def _line(name: str, seed: int, report: Report, errors: DepthErrors) -> str:
    assert report.psnr_db is not None
    assert report.trajectory is not None
    off, rest = errors.in_words()
    nate = report.trajectory.nate
    path = "      –" if nate is None else f"{nate:7.4f}"
    return f"{name:14} {seed:4}  {report.psnr_db.mean:6.2f} {path}   {off}, {rest}"
