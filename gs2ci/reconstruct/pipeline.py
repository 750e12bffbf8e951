"""From one coded measurement to views, camera path and Gaussian scene: the whole way on one page.

    hold out some pixels ─► decode ─► geometry ─► first Gaussians ─► coarse fit ─► residual ─► judge by the held-out

Here: the order, the clock, and the judgement. Not here: any stage itself; files and metrics (`gs2ci.evaluate`).
The commands import this file.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray

from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import F32, F64, Shot
from gs2ci.core.run_records import RunResult, Verdict
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.residual import ResidualSettings, refine_views
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseSettings, fit_coarse
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import choose_heldout
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.render.backend import Backend, load_backend
from gs2ci.render.gaussians import Gaussians

Score = Callable[[F32], float]


@dataclass(frozen=True)
class Settings:
    """Settings of every stage.

    Args:
        decode: Of the decoder that the geometry stage looks at.
        geometry: Of tracks, motion and depth.
        fit: Of the coarse stage.
        residual: Of the last step, which decodes what the scene leaves unexplained.
        stride_px: One first Gaussian for every so many pixels along rows and columns.
        backend: The renderer.
        seed: Of every random draw.
    """

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
        InputError: The shot's parts do not fit together.
        NumericsError: The fit is not finite from its first iteration on.
    """
    settings, progress = settings or Settings(), progress or Silent()
    shot.check()
    clock = _Stopwatch()
    heldout = choose_heldout(shot.masks, shot.saturated, settings.fit.hold_out.share, settings.seed)
    seen = _without(shot, heldout)

    decoded = gap_tv(seen, settings.decode, progress)
    clock.lap("decode")

    geometry = initialise(decoded, shot.intrinsics, settings.geometry, progress)
    start = first_gaussians(seed_points(geometry, decoded, settings.stride_px))
    clock.lap("geometry")

    backend = load_backend(settings.backend)
    fit = fit_coarse(
        shot, heldout, start, geometry, backend, settings.fit, settings.seed, progress, score, clock.began_s
    )
    scene_views, depth = _look(fit, geometry.intrinsics, shot, backend)
    refined = refine_views(seen, scene_views, settings.residual)
    candidates: dict[Verdict, F32] = {"refined": refined, "scene": scene_views, "decode": decoded}
    rms = {name: _heldout_rms(shot, heldout, views) for name, views in candidates.items()}
    verdict = _judge(rms)
    if verdict == "refined":  # the pixels that judged may now help as well
        candidates["refined"] = refine_views(shot, scene_views, settings.residual)
    clock.lap("fit")

    result = RunResult(
        views=candidates["scene"],
        refined=candidates["refined"],
        decode=decoded,
        depth=depth,
        world_to_camera=fit.world_to_camera,
        intrinsics=geometry.intrinsics,
        predicted_measurement=Coding.of(shot).forward(torch.from_numpy(candidates[verdict])).numpy(),
        curve=fit.curve,
        stopped_because=fit.stopped_because,
        seconds=clock.seconds(),
        gaussians=len(fit.scene),
        notes=geometry.notes,
        settings=asdict(settings),
        seed=settings.seed,
        verdict=verdict,
        heldout_rms=rms,
        geometry=_summary(geometry),
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


def _without(shot: Shot, heldout: NDArray[np.bool_]) -> Shot:
    """Close every mask over the held-out pixels, so that no stage can see them."""
    if not heldout.any():
        return shot
    return replace(shot, masks=shot.masks * ~heldout, measurement=shot.measurement * ~heldout[..., None])


def _look(fit: CoarseFit, intrinsics: F64, shot: Shot, backend: Backend) -> tuple[F32, F32]:
    """Render the scene's views, [N, H, W, C], and their depth, [N, H, W], zero where less than half is covered."""
    poses = torch.from_numpy(fit.world_to_camera).float()
    camera = torch.from_numpy(intrinsics).float()
    with torch.no_grad():
        images, _ = backend.views(fit.scene, poses, camera, shot.size)
        along_axis = fit.scene.means @ poses[:, 2, :3].T + poses[:, 2, 3]
        as_colour = along_axis.T[..., None].expand(-1, -1, 3).contiguous()
        depths, alphas = backend.views(fit.scene, poses, camera, shot.size, colours=as_colour)
    covered = alphas >= 0.5
    depth = torch.where(covered, depths[..., 0] / alphas.clamp(min=0.5), 0.0)
    views = images if shot.channels == 3 else images.mean(dim=3, keepdim=True)
    return views.numpy(), depth.numpy()


def _heldout_rms(shot: Shot, heldout: NDArray[np.bool_], views: F32) -> float | None:
    if not heldout.any():
        return None
    predicted = Coding.of(shot).forward(torch.from_numpy(views)).numpy()
    return float(np.sqrt(np.mean((predicted - shot.measurement)[heldout] ** 2, dtype=np.float64)))


def _judge(heldout_rms: dict[Verdict, float | None]) -> Verdict:
    """Name the candidate with the smallest held-out residual; without any held-out pixels, the scene itself."""
    known = {name: rms for name, rms in heldout_rms.items() if rms is not None}
    return min(known, key=lambda name: known[name]) if known else "scene"


def _summary(geometry: Geometry) -> dict[str, object]:
    return {
        "method": "tracks",
        "verdict": geometry.verdict,
        "focal_px": float(geometry.intrinsics[0, 0]),
        "focal_source": geometry.focal_source,
        "tracks": geometry.tracks,
        "reprojection_rms_px": geometry.reprojection_rms_px,
        "parallax_px": geometry.parallax_px,
        "reference": geometry.reference,
    }
