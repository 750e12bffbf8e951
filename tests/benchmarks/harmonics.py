"""The gain of colours that change with the direction of view: degree 0 and 3 with the same seeds, in turns.

    GS2CI_CASES="glossy boxes" GS2CI_PRESETS="draft standard" GS2CI_SEEDS="0 1" python -m tests.benchmarks harmonics

Each case is reconstructed by one fit of a preset, without a second look and without motion, with one colour for each
Gaussian and with spherical harmonics up to degree 3, at 96 x 128 px. Cases are scenes of the simulator's library, or
.npz files, cropped to their middle. It prints the scores of the delivered views, of the scene alone and of the views
between and beyond if they are known, the depth's error, and processor seconds; at the end the means with their standard
deviations, and the gain of degree 3, seed by seed. Without variables: glossy, boxes and motorcycle in preset standard
with seeds 0, 1 and 2, about three minutes of one processor, half of it for the ray tracing of `glossy`.
"""

import os
import time
from dataclasses import replace
from statistics import mean, stdev
from typing import Final

import numpy as np
import torch

from gs2ci.core.errors import Gs2ciError
from gs2ci.core.records import Shot
from gs2ci.evaluate.run_report import build_report
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.render.backend import load_backend
from tests.tables.beside import BesideViews, beside_path, scores_beside
from tests.tables.cases import Case

SIZE: Final = (96, 128)
DEGREES: Final = (0, 3)
COLUMNS: Final = ("views", "scene", "between", "beyond", "depth off, %", "CPU s")
Figures = tuple[float | None, ...]
"""In the order of `COLUMNS`; None if unknown."""


def run() -> None:
    """Reconstruct, print a line for each, and the table."""
    names = os.environ.get("GS2CI_CASES", "glossy boxes motorcycle").split()
    presets = _presets(os.environ.get("GS2CI_PRESETS", "standard").split())
    found: dict[tuple[str, PresetName, int], list[Figures]] = {}
    print(f"{'case':18} {'preset':9} seed degree  " + "  ".join(COLUMNS))
    for seed in map(int, os.environ.get("GS2CI_SEEDS", "0 1 2").split()):
        for name in names:
            file = name if name.endswith(".npz") else ""
            case = Case(os.path.basename(name), file=file, scene="" if file else name, size=SIZE)
            try:
                shot = case.shot(seed)
                true = case.novel_views(shot)
                # Both degrees of a seed or neither: they are compared seed by seed.
                of_seed = [(p, d, _judged(shot, true, p, seed, d)) for p in presets for d in DEGREES]
            except Gs2ciError as error:
                print(f"{case.name:18.18} left out: {error}", flush=True)
                continue
            for preset, degree, figures in of_seed:
                found.setdefault((case.name, preset, degree), []).append(figures)
    _print_means(found)


def _presets(wanted: list[str]) -> list[PresetName]:
    unknown = set(wanted) - set(PRESETS)
    if unknown:
        raise SystemExit(f"GS2CI_PRESETS names {', '.join(sorted(unknown))}; there are {', '.join(PRESETS)}")
    return [name for name in PRESETS if name in wanted]


def _judged(shot: Shot, true: BesideViews | None, preset: PresetName, seed: int, degree: int) -> Figures:
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
    beside = scores_beside(seen.numpy(), true).values()
    delivered, scene, depth = report.psnr_db, report.scene.psnr_db, report.depth
    figures = (
        *(None if one is None else one.mean for one in (delivered, scene)),
        *beside,
        None if depth is None else 100 * depth.median_rel,
        spent_s,
    )
    shown = "  ".join(f"{'-' if value is None else f'{value:.2f}':>6}" for value in figures)
    print(f"{shot.name:18.18} {preset:9} {seed:4} {degree:6} {shown}", flush=True)
    return figures


def _print_means(found: dict[tuple[str, PresetName, int], list[Figures]]) -> None:
    print(f"\n| | preset, seeds | | {' | '.join(COLUMNS)} |\n|---|---|---|{'---:|' * len(COLUMNS)}")
    for case, preset in dict.fromkeys((case, preset) for case, preset, _ in found):
        plain, varying = (np.array(found[case, preset, d], float) for d in DEGREES)
        lines = {f"degree {DEGREES[0]}": plain, f"degree {DEGREES[1]}": varying, "gain": varying - plain}
        for line, values in lines.items():
            cells = [_mean(list(column), sign="+" if line == "gain" else "") for column in values.T]
            print(f"| {case} | {preset}, {len(values)} | {line} | {' | '.join(cells)} |")


def _mean(values: list[float], sign: str) -> str:
    if np.isnan(values).any():
        return "–"
    return f"{mean(values):{sign}.2f}" + (f" ± {stdev(values):.2f}" if len(values) > 1 else "")
