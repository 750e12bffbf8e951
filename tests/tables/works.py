"""The functions behind table cells: plain arguments in, a row of figures out.

Not here: which of them a table needs (`catalogue`).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import torch

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import CurvePoint
from gs2ci.evaluate.depth import DepthErrors
from gs2ci.evaluate.run_report import build_report
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.trajectory import TrajectoryErrors, trajectory_errors
from gs2ci.reconstruct.first_look import look
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.evidence import unexplained
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.pipeline import Reconstruction, reconstruct
from gs2ci.render.backend import load_backend
from tests.tables.beside import PLACES, BesideViews, beside_path, depth_beside, scores_beside
from tests.tables.cases import Case
from tests.tables.order import depth_rank, inside_out
from tests.tables.variants import settings_of

# One rendering takes a millisecond or two, and anything else on the machine disturbs it: the least of many is told.
_RENDERINGS: Final = 10
COUNTED_AFTER: Final = (1_000, 3_000, 7_000)
"""Iterations of the paper's schedule: early, at the first reset of opacity, and where its population is bounded."""


def reconstruct_case(case: dict[str, Any], variant: str, seed: int) -> Row:
    """Reconstruct a case; figures in dB, full scales and seconds, None without a truth.

    Args:
        case: Fields of a `Case`.
        variant: A name in `variants.VARIANTS`.
        seed: Seed of masks, noise and the reconstruction's own draws.

    Raises:
        Gs2ciError: The case cannot be made, or not be reconstructed.
    """
    made = Case.of(case)
    shot = made.shot(seed)
    began_s = time.process_time()
    done = reconstruct(shot, settings_of(variant, seed))
    processor_seconds = time.process_time() - began_s
    report = build_report(shot, done.result)
    psnr, ssim, trajectory = report.psnr_db, report.ssim, report.trajectory
    elsewhere, depth_there = _score_beside_path(done, shot, made.novel_views(shot))
    depth = report.depth or depth_there
    decode_psnr, scene_psnr = report.decode.psnr_db, report.scene.psnr_db
    return {
        "psnr_db": psnr and psnr.mean,
        "ssim": ssim and ssim.mean,
        "scene_psnr_db": scene_psnr and scene_psnr.mean,
        **elsewhere,
        **_path(report.trajectory),
        "depth_rel_percent": depth and 100 * depth.median_rel,
        "depth_rank": depth and depth.rank,
        "depth_px": depth and depth.median_px,
        "failure": inside_out(
            None if trajectory is None else trajectory.rotation_deg, None if depth is None else depth.rank
        ),
        "decode_psnr_db": decode_psnr and decode_psnr.mean,
        "heldout_rms": report.heldout_rms,
        "seconds": report.seconds["total"],
        "processor_seconds": processor_seconds,
        "gaussians": report.gaussians,
        **_population(done.result.curve),
        "verdict": report.verdict,
        "source": done.result.geometry.method,
        "codes": sorted({note.code.value for note in done.result.notes}),
        "stopped": report.stopped.code.value,
    }


def _population(curve: Sequence[CurvePoint]) -> Row:
    """Count the iterations, the Gaussians after some of them, and the most that there were at any look of the fit."""
    counted = {point.iteration: point.gaussians for point in curve}
    row: Row = {f"gaussians_after_{iteration}": counted.get(iteration) for iteration in COUNTED_AFTER}
    return {
        **row,
        "gaussians_most": max(counted.values(), default=None),
        "iterations": max(counted, default=None),
        "population": sorted(counted.items()),
    }


def _score_beside_path(done: Reconstruction, shot: Shot, true: BesideViews | None) -> tuple[Row, DepthErrors | None]:
    """Score the scene alone from beside its path, dB, and count how many views a second it renders.

    Its depth is scored there as well where that is known: of files, which tell no depth of the recorded views.
    """
    row: Row = {**{f"{place}_psnr_db": None for place in PLACES}, "frames_per_second": None}
    if done.scene.motion is not None or shot.views < 2 or shot.distortion is not None:
        return row, None
    backend, intrinsics = load_backend(), torch.from_numpy(done.result.intrinsics).float()
    poses = torch.from_numpy(beside_path(done.result.world_to_camera)).float()
    with torch.no_grad():
        images, _ = backend.views(done.scene, poses, intrinsics, shot.size)
        took_s = least_seconds(lambda: backend.views(done.scene, poses, intrinsics, shot.size), _RENDERINGS)
        row["frames_per_second"] = len(poses) / took_s
    depth: DepthErrors | None = None
    if true is not None and true.depth is not None:
        surface = backend.depths(done.scene, poses[:1], intrinsics, shot.size).surface()[0].numpy()
        depth = depth_beside(surface, true, shot, done.result.intrinsics)
    return {**row, **scores_beside(images.numpy(), true)}, depth


def least_seconds(work: Callable[[], object], times: int) -> float:
    """Do some work several times; return the seconds by the clock that the fastest took."""
    seconds = []
    for _ in range(times):
        began_s = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began_s)
    return min(seconds)


def _path(errors: TrajectoryErrors | None) -> Row:
    """Return the errors of a path as the paper's Table VI has them; nRPE_t is RPE_t over the extent, as nATE is."""
    extent = errors.ate / errors.nate if errors is not None and errors.nate else None
    return {
        "ate": errors and errors.ate,
        "nate": errors and errors.nate,
        "rpe_t": errors and errors.rpe_t,
        "nrpe_t": errors.rpe_t / extent if errors and extent and errors.rpe_t is not None else None,
        "rpe_r_deg": errors and errors.rpe_r_deg,
        "translation_mean": errors and errors.translation_mean,
        "rotation_deg": errors and errors.rotation_deg,
    }


def initialise_case(case: dict[str, Any], variant: str, seed: int) -> Row:
    """Find the first geometry of a case; figures compared with the truth are None without a truth.

    Args:
        case: Fields of a `Case`.
        variant: A name in `variants.VARIANTS`.
        seed: Seed of masks, noise and held-out pixels.

    Raises:
        Gs2ciError: The case cannot be made, or its geometry cannot be estimated.
    """
    shot, settings = Case.of(case).shot(seed), settings_of(variant, seed).check()
    prior, lens = load_geometry_prior(settings.poses), Lens.of(shot)
    began_s = time.monotonic()
    holdout = Holdout.of(shot, settings.fit.hold_out.share, settings.seed)
    once = replace(settings, brightness=BrightnessSettings(rounds=0))
    first = look(holdout, lens, prior, once, Silent(), lambda _: None)
    seconds = time.monotonic() - began_s
    geometry = first.geometry
    truth = shot.truth.world_to_camera
    errors = None if truth is None else trajectory_errors(geometry.world_to_camera, truth)
    true_depth = None if shot.truth.depth is None else shot.truth.depth[geometry.reference]
    known = geometry.verdict == "full" and true_depth is not None
    rank = depth_rank(1 / geometry.inverse_depth, true_depth) if known and true_depth is not None else None
    return {
        "nate": errors and errors.nate,
        "depth_rank": rank,
        "failure": inside_out(None if errors is None else errors.rotation_deg, rank),
        "rpe_r_deg": errors and errors.rpe_r_deg,
        "unexplained": unexplained(holdout.seen, straightened(first.decoded, lens), geometry, lens),
        "tracks": geometry.tracks,
        "path_error_expected": geometry.path_error_expected,
        "full": float(geometry.verdict == "full"),
        "seconds": seconds,
        "source": geometry.source,
        "verdict": geometry.verdict,
        "notes": [note.sentence for note in geometry.notes],
    }
