"""From one coded measurement to views, camera path and Gaussian scene: the whole way on one page.

    hold out some pixels ─► decode ─► geometry ─► first Gaussians ─► coarse fit ─► residual ─► judge by the held-out

Here: the order, the clock, and the judgement. Not here: any stage itself; files and metrics (`gs2ci.evaluate`).
The commands import this file.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import F32, F64, Shot
from gs2ci.core.run_records import RunResult, Verdict
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.residual import ResidualSettings, refine_views
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseSettings, fit_coarse
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import Jury, choose_heldout
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.render.backend import Backend, load_backend
from gs2ci.render.gaussians import Gaussians

Score = Callable[[F32], float]
PoseSource = Literal["tracks", "stage"]


@dataclass(frozen=True)
class Settings:
    """Settings of every stage.

    Args:
        poses: Where the initial poses come from: found in the decoded views ("tracks"), or the shot's telemetry
            ("stage").
        decode: Of the decoder that the geometry stage looks at.
        geometry: Of tracks, motion and depth.
        fit: Of the coarse stage.
        residual: Of the last step, which decodes what the scene leaves unexplained.
        stride_px: One first Gaussian for every so many pixels along rows and columns.
        backend: The renderer.
        seed: Of every random draw.
    """

    poses: PoseSource = "tracks"
    decode: GapTvSettings = field(default_factory=GapTvSettings)
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    fit: CoarseSettings = field(default_factory=CoarseSettings)
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    stride_px: int = 3
    backend: str = "cpu"
    seed: int = 42


@dataclass(frozen=True)
class Reconstruction:
    """What was recovered: the record of the run, and the Gaussians."""

    result: RunResult
    scene: Gaussians


def reconstruct(
    shot: Shot,
    settings: Settings | None = None,
    progress: Progress | None = None,
    score: Score | None = None,
) -> Reconstruction:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: The measurement; its truth is not read.
        settings: Settings of every stage.
        progress: Told of every stage and step.
        score: Turns views, [N, H, W, C], into a figure for the curve, in dB; it may know the truth.

    Returns:
        The best of three by the held-out pixels: the scene's views refined by its residual, the scene's views, or
        the decode; and the other two.

    Raises:
        InputError: The shot's parts do not fit together, or poses are to come from telemetry that it does not hold.
        GeometryError: The telemetry contradicts the decoded views.
        NumericsError: The fit is not finite from its first iteration on.
    """
    settings, progress = settings or Settings(), progress or Silent()
    shot.check()
    clock = _Stopwatch()
    jury = Jury(shot, choose_heldout(shot.masks, shot.saturated, settings.fit.hold_out.share, settings.seed))
    seen = jury.seen

    decoded = gap_tv(seen, settings.decode, progress)
    clock.lap("decode")

    known_poses = _known_poses(shot, settings.poses)
    geometry = initialise(decoded, shot.intrinsics, settings.geometry, progress, known_poses)
    start = first_gaussians(seed_points(geometry, decoded, settings.stride_px))
    clock.lap("geometry")

    backend = load_backend(settings.backend)
    fit = fit_coarse(
        jury=jury,
        start=start,
        geometry=geometry,
        backend=backend,
        settings=settings.fit,
        seed=settings.seed,
        refine=lambda views: refine_views(seen, views, settings.residual),
        progress=progress,
        score=score,
        since_s=clock.began_s,
    )
    refined = refine_views(seen, fit.views, settings.residual)
    heldout_rms: dict[Verdict, float | None] = {
        "refined": jury.residual_rms(refined),
        "scene": jury.residual_rms(fit.views),
        "decode": jury.residual_rms(decoded),
    }
    verdict = _judge(heldout_rms)
    if verdict == "refined":  # the pixels that judged may now help as well
        refined = refine_views(shot, fit.views, settings.residual)
    recovered = {"refined": refined, "scene": fit.views, "decode": decoded}[verdict]
    moved = _moved_poses(geometry.world_to_camera, fit.world_to_camera)
    depth = _depth(fit, geometry.intrinsics, shot.size, backend)
    clock.lap("fit")

    result = RunResult(
        views=recovered,
        scene_views=fit.views,
        decode=decoded,
        depth=depth,
        world_to_camera=fit.world_to_camera,
        intrinsics=geometry.intrinsics,
        predicted_measurement=Coding.of(shot).forward(torch.from_numpy(recovered)).numpy(),
        curve=fit.curve,
        stopped_because=fit.stopped_because,
        seconds=clock.seconds(),
        gaussians=len(fit.scene),
        notes=(*geometry.notes, *_note_of_stage(settings.poses, moved)),
        settings=asdict(settings),
        seed=settings.seed,
        verdict=verdict,
        heldout_rms=heldout_rms,
        geometry={**_summary(geometry, settings.poses), "moved": moved},
    )
    return Reconstruction(result.check(), fit.scene)


class _Stopwatch:
    """Wall-clock seconds by stage."""

    def __init__(self) -> None:
        self.began_s = self._lap_s = time.monotonic()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = time.monotonic()
        self._stages[stage] = now - self._lap_s
        self._lap_s = now

    def seconds(self) -> dict[str, float]:
        return {**self._stages, "total": self._lap_s - self.began_s}


def _known_poses(shot: Shot, source: PoseSource) -> F64 | None:
    if source == "stage" and shot.telemetry_world_to_camera is None:
        raise InputError(
            f"{shot.name} holds no poses from a stage",
            allowed="--geometry tracks",
            remedy="capture with a stage in the rig file, or give poses at import",
        )
    return shot.telemetry_world_to_camera if source == "stage" else None


def _moved_poses(start: F64, end: F64) -> dict[str, float]:
    """Say how far the fit moved the poses, root mean square: in degrees, and as a share of the camera path's extent."""
    change = end @ np.linalg.inv(start)
    change = change @ np.linalg.inv(change[len(change) // 2])  # a common change is a change of the world's frame
    centres = np.linalg.inv(start)[:, :3, 3]
    extent = float(np.linalg.norm(np.ptp(centres, axis=0)))
    shift = float(np.sqrt((change[:, :3, 3] ** 2).sum(axis=1).mean()))
    angles = Rotation.from_matrix(change[:, :3, :3]).magnitude()
    return {
        "rotation_deg": float(np.degrees(np.sqrt((angles**2).mean()))),
        "share_of_path": shift / extent if extent > 0 else 0.0,
    }


def _depth(fit: CoarseFit, intrinsics: F64, size: tuple[int, int], backend: Backend) -> F32:
    """Render the mean depth along the optical axis, [N, H, W]; zero where less than half of the light is stopped."""
    poses = torch.from_numpy(fit.world_to_camera).float()
    along_axis = fit.scene.means @ poses[:, 2, :3].T + poses[:, 2, 3]
    as_colour = along_axis.T[..., None].expand(-1, -1, 3).contiguous()
    camera = torch.from_numpy(intrinsics).float()
    with torch.no_grad():
        depths, alphas = backend.views(fit.scene, poses, camera, size, colours=as_colour)
    return torch.where(alphas >= 0.5, depths[..., 0] / alphas.clamp(min=0.5), 0.0).numpy()


def _judge(heldout_rms: dict[Verdict, float | None]) -> Verdict:
    """Name the candidate with the smallest held-out residual; without any held-out pixels, the scene itself."""
    known = {name: rms for name, rms in heldout_rms.items() if rms is not None}
    return min(known, key=lambda name: known[name]) if known else "scene"


def _note_of_stage(source: PoseSource, moved: dict[str, float]) -> tuple[str, ...]:
    if source == "tracks":
        return ()
    share, rotation_deg = moved["share_of_path"], moved["rotation_deg"]
    return (f"The fit moved the stage's poses by {share:.1%} of the path and {rotation_deg:.3f}°.",)


def _summary(geometry: Geometry, source: PoseSource) -> dict[str, object]:
    return {
        "method": source,
        "verdict": geometry.verdict,
        "focal_px": float(geometry.intrinsics[0, 0]),
        "focal_source": geometry.focal_source,
        "tracks": geometry.tracks,
        "reprojection_rms_px": geometry.reprojection_rms_px,
        "parallax_px": geometry.parallax_px,
        "reference": geometry.reference,
    }
