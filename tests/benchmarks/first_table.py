"""The README's first table: results on data of different kinds.

    GS2CI_SHARED_DATA=FOLDER python -m tests.benchmarks first_table

Every row states its data. Anybody can make these again: scikit-image's photographs on planes, a simulated bench with
noise, blur and errors of calibration, calibrated and captured through its drivers, and scenes that the simulator draws
ray by ray (Gaussians, and textured meshes), which share no code with the solver. If the folder is given, these
follow: eight real photographs far apart, a path-traced light field, a real hardware exposure (without a truth), and the
noise-free renderings of a Gaussian scene, the solver's own model class. "Left" is the root mean square residual of the
measurement with the delivered views, in full scales of one view.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import measurement_residual, psnr_per_view
from gs2ci.evaluate.novel_views import NovelViews
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import Reconstruction, reconstruct
from gs2ci.render.backend import load_backend
from gs2ci_sims.exact import ExactRenderer
from tests.benchmarks.calibrated_reconstruction import BENCHES, take
from tests.benchmarks.own_model_class import MESHES, RAYS_THROUGH_MESHES, taken
from tests.benchmarks.photographs import expose
from tests.tables.beside import beside_path

FOLDER = Path(os.environ.get("GS2CI_SHARED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def _read(name: str) -> Shot:
    return import_shots(FOLDER / name, None, ImportOptions()).shots[0]


def _between(name: str, poses: F64) -> NovelViews:
    """Return the light field's uncoded view, half way between the fourth and the fifth pose."""
    with np.load(FOLDER / name) as arrays:
        view = arrays["view"]
    view = (view / np.float32(255) if view.dtype == np.uint8 else view).astype(np.float32)
    pose = poses[3].copy()
    pose[:3, 3] = (poses[3, :3, 3] + poses[4, :3, 3]) / 2
    return NovelViews(view[None], pose[None])


def rows() -> Iterator[tuple[str, str, Shot, NovelViews | None]]:
    """Yield name, what the data are, the shot, and views from elsewhere."""
    for which in range(3):
        shot, _, (images, poses) = expose(which, seed=which, noise=0.01)
        yield f"photographs on planes {which}", "cast rays, 1 % noise", shot, NovelViews(images, poses)
    bench = take(BENCHES["off"], seed=1)
    yield "simulated bench, calibrated", "Gaussian scene, sensor noise, blur", bench.shots["calibrated"], None
    size = (96, 128)
    yield "boxes, by rays", "Gaussian scene, drawn ray by ray, noise", taken("boxes", ExactRenderer(), 0, size), None
    for name in MESHES:
        yield f"{name}, a mesh", "textured mesh, noise", taken(name, RAYS_THROUGH_MESHES, 0, size), None
    if not FOLDER.is_dir():
        print(f"(no folder of measurements at GS2CI_SHARED_DATA={FOLDER}: its rows are left out)")
        return
    yield "photographs far apart", "real photographs, no noise", _read("fern_photos_wide.npz"), None
    shot = _read("lightfield/antinous.npz")
    poses = shot.truth.world_to_camera
    assert poses is not None
    yield "light field", "path-traced, no noise", shot, _between("lightfield/antinous_between.npz", poses)
    yield "turning fan", "real hardware exposure, no truth", _read("real_cacti/4fan14_cacti.mat"), None
    for name in ("fern_smooth", "fern_smooth_cr16", "fern_smooth_r50"):
        yield name, "rendered from a Gaussian scene, no noise", _read(f"{name}.npz"), None


def _mean_db(views: F32, shot: Shot) -> str:
    return "–" if shot.truth.views is None else f"{np.mean(psnr_per_view(views, shot.truth.views)):.1f}"


def elsewhere_db(run: Reconstruction, shot: Shot, novel: NovelViews | None) -> list[str]:
    """Return PSNR of the scene alone, half way between the two middle views and one step beyond the last.

    From places on the recovered path (`beside_path`).
    """
    if novel is None:
        return ["–", "–"]
    at = torch.from_numpy(beside_path(run.result.world_to_camera)[: len(novel.views)]).float()
    intrinsics = torch.from_numpy(run.result.intrinsics).float()
    with torch.no_grad():
        images, _ = load_backend().views(run.scene, at, intrinsics, shot.size)
    told = psnr_per_view(images.numpy(), novel.views)
    return [f"{figure:.1f}" for figure in told] + ["–"] * (2 - len(told))


def run() -> None:
    """Reconstruct each with default settings and print the table."""
    print("| measurement | data | decode | delivered views | scene alone | between | beyond | left, rms | s |")
    print("|---|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, data, shot, novel in rows():
        begin_s = time.monotonic()
        try:
            done = reconstruct(shot)
        except Gs2ciError as error:
            print(f"| {name} | {data} | refused: {error.problem} | | | | | | |", flush=True)
            continue
        seconds = time.monotonic() - begin_s
        result = done.result
        figures = [_mean_db(gap_tv(shot), shot), _mean_db(result.views, shot)]
        figures += ["–" if result.scene_views is None else _mean_db(result.scene_views, shot)]
        figures += elsewhere_db(done, shot, novel)
        left = measurement_residual(result.predicted_measurement, shot.measurement, shot.saturated).rms
        print(f"| {name} | {data} | {' | '.join(figures)} | {left:.4f} | {seconds:.0f} |", flush=True)
