"""What colours that change with the direction of sight give: degree 0 and 3 with the same seed, in turns.

    GS2CI_CASES="glossy boxes" GS2CI_PRESETS="draft standard" GS2CI_SEEDS=3 python -m tests.benchmarks harmonics

Each case is reconstructed by one fit of a preset, without a second look and without motion, with one colour for each
Gaussian and with spherical harmonics up to degree 3, at 96 x 128 px. Cases are scenes of the simulator's library, or
.npz files, of which the middle is kept. Printed are the views that are handed over, the scene alone, the views between
and beyond where they are known, the depth's error, and processor seconds.
"""

import os
import time
from dataclasses import replace

import torch

from gs2ci.evaluate.novel_views import beside_path
from gs2ci.evaluate.run_report import build_report
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.render.backend import load_backend
from gs2ci.tables.beside import scores_beside
from gs2ci.tables.cases import Case

SIZE = (96, 128)
DEGREES = (0, 3)


def run() -> None:
    """Reconstruct, and print a line for each."""
    cases = os.environ.get("GS2CI_CASES", "glossy boxes motorcycle").split()
    presets = [name for name in PRESETS if name in os.environ.get("GS2CI_PRESETS", "draft standard").split()]
    print(f"{'case':18} {'preset':9} seed degree  views  scene  between  beyond  depth off, %  CPU s")
    for seed in range(int(os.environ.get("GS2CI_SEEDS", "3"))):
        for name in cases:
            file = name if name.endswith(".npz") else ""
            case = Case(name, file=file, scene="" if file else name, size=SIZE)
            for preset in presets:
                for degree in DEGREES:
                    _line(case, preset, seed, degree)


def _line(case: Case, preset: PresetName, seed: int, degree: int) -> None:
    shot = case.shot(seed)
    settings = replace(PRESETS[preset], seed=seed, fits=1, look_again=False, motion="off")
    settings = replace(settings, fit=replace(settings.fit, colours=replace(settings.fit.colours, degree=degree)))
    began_s = time.process_time()
    done = reconstruct(shot, settings)
    spent_s = time.process_time() - began_s
    report = build_report(shot, done.result)
    poses = torch.from_numpy(beside_path(done.result.world_to_camera)).float()
    with torch.no_grad():
        intrinsics = torch.from_numpy(done.result.intrinsics).float()
        seen, _ = load_backend().views(done.scene, poses, intrinsics, shot.size)
    beside = scores_beside(seen.numpy(), case.novel_views(shot)).values()
    delivered, scene, depth = report.psnr_db, report.scene.psnr_db, report.depth
    found: list[float | None] = [None if one is None else one.mean for one in (delivered, scene)]
    found += [*beside, None if depth is None else 100 * depth.median_rel]
    shown = "  ".join(f"{'-' if value is None else f'{value:.2f}':>6}" for value in found)
    print(f"{os.path.basename(case.name):18.18} {preset:9} {seed:4} {degree:6} {shown} {spent_s:10.0f}", flush=True)
