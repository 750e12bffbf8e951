"""How often results lie within their standard errors, on scenes of known truth.

    GS2CI_SHARED_DATA=FOLDER python -m tests.benchmarks reliability

Drawn scenes (`reliability_draws`), with noise, and a light field if the folder holds it. The factors of
`gs2ci/reconstruct/uncertainty/factors.py` were fixed on the seeds 6200 and 6201; the others judge them. For each scene:
the share of errors within one and within two standard errors of the views' values, depths, positions, rotations, and
lengths between random pixels of the middle view, as `gs2ci measure` states them. Depth and lengths are compared after
one scale for each scene, which no image determines, unless a stage gave their unit; positions after a similarity,
rotations after the turn that all cameras have in common. Where near and far are exchanged, errors are not those that a
standard error describes: such scenes count for views alone, and are named, with whether the report says so. Then the
share of the time that they take, the means over the scenes, and a diagram as a table: the share within each multiple of
the standard error, beside that of a normal and of a Laplace distribution with 68 % within one.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_SEEDS` | the seeds | 6300 6301 |
| `GS2CI_PRESET` | the preset | draft |
| `GS2CI_RUNS` | a folder in which runs are kept; those found state their errors anew, by today's rules | none |
| `GS2CI_KINDS` | some of `reliability_draws.KINDS`, with commas between them | all |
| `GS2CI_SIZE` | their size, px | 72x96 |
| `GS2CI_STRANGERS` | 1: scenes and motions of `stranger_draws` instead | 0 |
"""

import os
import pickle
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.core.findings import Code
from gs2ci.core.ranks import rank_correlation
from gs2ci.core.records import Shot
from gs2ci.evaluate.evaluation import FinishedRun
from gs2ci.evaluate.measuring import measure
from gs2ci.evaluate.pages.run_evidence import read_run
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.trajectory import align
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.uncertainty.of_run import how_sure
from gs2ci.render.backend import load_backend
from tests.benchmarks.beside_files import SHARED
from tests.benchmarks.reliability_draws import KINDS, Draw, drawn, light_fields
from tests.benchmarks.stranger_draws import MOTIONS, SCENES, stranger
from tests.processes import side_by_side

SEEDS: Final = tuple(int(seed) for seed in os.environ.get("GS2CI_SEEDS", "6300 6301").split())
WANTED: Final = os.environ.get("GS2CI_KINDS", ",".join(KINDS)).split(",")
PRESET: Final = os.environ.get("GS2CI_PRESET", "draft")
RUNS: Final = os.environ.get("GS2CI_RUNS")
STRANGERS: Final = os.environ.get("GS2CI_STRANGERS", "0") == "1"
PAIRS: Final = 300
MULTIPLES: Final = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
QUANTITIES: Final = ("views", "depth", "positions", "rotations", "lengths")

Off = dict[str, F64]
"""Errors in standard errors, by quantity."""


def run() -> None:
    """Judge every draw, and print a row for each, the means and the diagram."""
    kinds = [f"{scene} {motion}" for scene in SCENES for motion in MOTIONS] if STRANGERS else WANTED
    tasks = [(kind, seed) for seed in SEEDS for kind in kinds]
    if not STRANGERS and (SHARED / "lightfield" / "antinous.npz").is_file():
        tasks.append(("light field", 0))
    print(f"| scene | order | {' | '.join(f'{name}, within 1, 2' for name in QUANTITIES)} |")
    print("|---|---|" + "---|" * len(QUANTITIES))
    shares: dict[str, list[list[float]]] = {name: [] for name in QUANTITIES}
    costs: list[float] = []
    for (kind, seed), (order, found, cost) in zip(tasks, side_by_side(judge, tasks), strict=True):
        cells = [f"{found[name][2]:.2f}, {found[name][4]:.2f}" if name in found else "–" for name in QUANTITIES]
        print(f"| {kind}{f' {seed}' if seed else ''} | {order} | {' | '.join(cells)} |", flush=True)
        costs.append(cost)
        for name in QUANTITIES:
            if name in found and (name == "views" or not order.startswith("reversed")):
                shares[name].append(found[name])
    print(f"\n{100 * np.mean(costs):.1f} % of a run's time, at most {100 * max(costs):.1f} %")
    print(f"\n| | scenes | {' | '.join(f'within {multiple:g}' for multiple in MULTIPLES)} |")
    print("|---|---|" + "---|" * len(MULTIPLES))
    for name, rows in shares.items():
        if rows:
            print(f"| {name} | {len(rows)} | {' | '.join(f'{mean:.3f}' for mean in np.mean(rows, axis=0))} |")
    for name, within in (("normal", _normal), ("Laplace", _laplace)):
        print(f"| {name} | | {' | '.join(f'{within(multiple):.3f}' for multiple in MULTIPLES)} |")


def judge(wanted: tuple[str, int]) -> tuple[str, dict[str, list[float]], float]:
    """Reconstruct a draw; return its order of near and far, the shares within each multiple, and that of the time."""
    kind, seed = wanted
    if STRANGERS:
        shot = stranger(*kind.split(), seed)
        draw = Draw(shot.name, shot)
    else:
        draw = drawn(kind, seed) if seed else next(_light_field())
    with tempfile.TemporaryDirectory() as own:
        run_of = _finished(draw, Path(RUNS or own) / f"{draw.name.replace(' ', '_')}_{PRESET}")
        order, off = errors(draw, run_of)
    seconds = run_of.report.seconds
    shares = {name: [float(np.mean(values <= k)) for k in MULTIPLES] for name, values in off.items()}
    return order, shares, seconds.get("uncertainty", 0.0) / seconds["total"]


def _light_field() -> Iterator[Draw]:
    return light_fields(SHARED / "lightfield")


class _Asked(pickle.Pickler):
    """Keeps what `how_sure` is asked with; renderers without their backend."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, ShotRenderer):
            return _renderer, (obj.shot, obj.intrinsics.double().numpy(), obj.lens)
        return NotImplemented


def _renderer(shot: Shot, intrinsics: F64, lens: Lens | None) -> ShotRenderer:
    return ShotRenderer(shot, intrinsics, load_backend(), lens)


def _finished(draw: Draw, folder: Path) -> FinishedRun:
    asked = folder / "asked.pickle"
    if not folder.is_dir():
        with patch.object(pipeline, "how_sure", side_effect=how_sure) as asking:
            found = pipeline.reconstruct(draw.shot, preset(PRESET))  # type: ignore[arg-type]
        write_run(folder, draw.shot, found.result, found.scene)
        with asked.open("wb") as file:
            _Asked(file).dump(asking.call_args.args)
    run_of = read_run(folder)
    sure = how_sure(*pickle.loads(asked.read_bytes()))
    assert run_of.report.sureness is not None
    said = replace(run_of.report.sureness, positions=None, rotations_deg=None)
    if sure.positions is not None and sure.rotations is not None:
        turned_deg = np.degrees(sure.rotations).tolist()
        said = replace(said, positions=sure.positions.tolist(), rotations_deg=turned_deg)
    report = run_of.report.model_copy(update={"sureness": said})
    return replace(run_of, report=report, views_error=sure.views, depth_error=sure.depth)


def errors(draw: Draw, run_of: FinishedRun) -> tuple[str, Off]:
    """Return what became of the order of near and far, and all errors of a run in standard errors."""
    truth, said = draw.shot.truth, run_of.report.sureness
    assert truth.views is not None
    assert truth.world_to_camera is not None
    assert said is not None
    assert run_of.views_error is not None
    stated = run_of.views_error
    off: Off = {"views": (np.abs(run_of.views - truth.views) / stated[..., None]).ravel()}
    if run_of.depth is None or run_of.depth_error is None or said.positions is None or said.rotations_deg is None:
        return "no path", off
    off |= _of_poses(run_of, truth.world_to_camera, np.array(said.positions), np.radians(said.rotations_deg))
    if truth.depth is None:
        return "unknown", off
    true = np.nan_to_num(truth.depth.astype(np.float64), posinf=0)
    both = (true > 0) & (run_of.depth > 0)
    geometry = run_of.report.geometry
    given = geometry is not None and geometry.unit_of is not None
    scale = 1.0 if given else float(np.median(true[both] / run_of.depth[both]))
    off["depth"] = np.abs(scale * run_of.depth[both] - true[both]) / (scale * run_of.depth_error[both])
    off["lengths"] = _of_lengths(run_of, true, both, scale)
    order = "right" if rank_correlation(true[both], run_of.depth[both]) > 0 else "reversed"
    is_said = run_of.report.found(Code.DEPTH_ORDER_OPEN)
    return f"{order}{', said open' if is_said else ''}", off


def _of_poses(run_of: FinishedRun, true: F64, positions: F64, rotations: F64) -> Off:
    poses = run_of.world_to_camera
    similar = align(poses, true)
    far = np.linalg.norm(camera_centres(similar.apply(poses)) - camera_centres(true), axis=1) / similar.scale
    in_world = Rotation.from_matrix(np.einsum("nji,njk->nik", poses[:, :3, :3], true[:, :3, :3]))
    turned = (in_world * in_world.mean().inv()).magnitude()
    return {"positions": far / positions, "rotations": turned / rotations}


def _of_lengths(run_of: FinishedRun, true: F64, known: np.ndarray, scale: float) -> F64:
    """Return the errors of lengths between random places in pixels of the middle view."""
    rng, view = np.random.default_rng(0), len(true) // 2
    rows, columns = np.nonzero(known[view])
    inverse = np.linalg.inv(run_of.intrinsics)
    found = []
    for _ in range(PAIRS):
        ends = rng.choice(len(rows), 2, replace=False)
        pixels = [(int(columns[end]), int(rows[end])) for end in ends]
        places = [true[view, y, x] * inverse @ [x + rng.random(), y + rng.random(), 1] for x, y in pixels]
        length = measure(run_of, pixels[0], pixels[1], view)
        wanted = float(np.linalg.norm(places[1] - places[0]))
        found.append(abs(scale * length.length - wanted) / (scale * length.standard_error))
    return np.array(found)


def _normal(multiple: float) -> float:
    return float(2 * norm.cdf(multiple) - 1)


def _laplace(multiple: float) -> float:
    return float(1 - (1 - _normal(1)) ** multiple)
