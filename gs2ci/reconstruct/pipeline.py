"""From one coded measurement to views, camera path and Gaussian scene: the whole way on one page.

    hold out some pixels ─► first look (decode, geometry, brightness) ─► first Gaussians ─► coarse fits (─► fine fit)
    ─► their mean ─► residual ─► judge by the held-out

Here: the order, the clock, and the judgement. Not here: any stage itself; files and metrics (`gs2ci.evaluate`).
The commands import this file.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Final, get_args

import torch

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import F32, Shot
from gs2ci.core.run_records import CurvePoint, RunResult, Verdict
from gs2ci.reconstruct.brightness import BrightnessSettings
from gs2ci.reconstruct.coding import Coding
from gs2ci.reconstruct.dead_lines import close_dead_lines
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings
from gs2ci.reconstruct.decode.residual import ResidualSettings
from gs2ci.reconstruct.doubts import doubts_about, doubts_about_result
from gs2ci.reconstruct.first_look import FirstLook, LookSettings, ProxyName, look
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseSettings, fit_coarse
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.ensemble import MOST_FITS, Ensemble, Member, combined, fit_together, members
from gs2ci.reconstruct.fit.fine import Fine, FineSettings, fit_fine
from gs2ci.reconstruct.fit.pace import Pace
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import Jury, choose_heldout
from gs2ci.reconstruct.fit.through_lens import through
from gs2ci.reconstruct.fit.withheld import Withheld, first_points, first_poses
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings
from gs2ci.reconstruct.geometry.prior import GeometryPrior
from gs2ci.reconstruct.geometry.telemetry import Movement, movement
from gs2ci.reconstruct.holes import fill_holes
from gs2ci.reconstruct.hot_pixels import close_hot_pixels
from gs2ci.reconstruct.lens import Lens, straightened
from gs2ci.reconstruct.one_thread import one_torch_thread
from gs2ci.render.backend import Backend, load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.settings import RasterSettings

Score = Callable[[F32], float]
PoseSource = str

# Lists kept so long lose nothing beside the spread of seeds (−0.06 to 0.02 dB) and save a tenth of an iteration
# (`python -m tests.benchmarks list_reuse`).
_RELIST_EVERY: Final = 4
_UNJUDGED: Final = "No pixel was held out, so nothing tells whether the scene is better than the decode; both are kept."


@dataclass(frozen=True)
class Settings:
    """Settings of every stage.

    Args:
        poses: Where the initial poses and depth come from: "tracks", "stage", "auto", "file:PATH"
            (`geometry.choose`).
        proxy: The views that the geometry stage looks at: those decoded by GAP-TV, or the proxies of the paper.
        decode: Of the decoder that the geometry stage looks at.
        geometry: Of tracks, motion and depth.
        fit: Of the coarse stage.
        fits: How many coarse fits run side by side; the views are their mean (`fit/ensemble.py`).
        second_density: The density rule of every second of them; None: that of the first.
        fine: Of the fine stage; None leaves it out.
        residual: Of the last step, which decodes what the scene leaves unexplained.
        stride_px: One first Gaussian for every so many pixels along rows and columns.
        withheld: What of the geometry the fit does not get; for ablations.
        backend: The renderer.
        raster: What the renderer may leave out for speed.
        brightness: Of the views' brightness, where the weights are wrong.
        seed: Of every random draw.
    """

    poses: PoseSource = "tracks"
    proxy: ProxyName = "gap-tv"
    decode: GapTvSettings = field(default_factory=GapTvSettings)
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    fit: CoarseSettings = field(default_factory=CoarseSettings)
    fits: int = 2
    second_density: DensityRule | None = field(default_factory=Osgr.generous)
    fine: FineSettings | None = None
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    stride_px: int = 3
    withheld: Withheld = field(default_factory=Withheld)
    backend: str = "cpu"
    raster: RasterSettings = field(default_factory=lambda: RasterSettings(relist_every=_RELIST_EVERY))
    brightness: BrightnessSettings = field(default_factory=BrightnessSettings)
    seed: int = 42

    @property
    def look(self) -> LookSettings:
        """Get the settings of all that comes before the fit."""
        return LookSettings(self.proxy, self.decode, self.geometry, self.brightness)

    @property
    def density_rules(self) -> tuple[DensityRule, ...]:
        """Get the density rules that the fits take in turn."""
        return (self.fit.density,) if self.second_density is None else (self.fit.density, self.second_density)

    def with_density_rule(self, name: str) -> "Settings":
        """Return settings in which every fit has the density rule of a name, unless the first has it already.

        Raises:
            InputError: There is no rule of that name.
        """
        fit = with_rule(self.fit, name)
        return self if fit is self.fit else replace(self, fit=fit, second_density=None)

    def check(self) -> "Settings":
        """Return self if the numbers make sense.

        Raises:
            InputError: A stage's settings, the stride, the number of fits or the seed are out of range.
        """
        if self.proxy not in get_args(ProxyName):
            raise InputError(f"proxy {self.proxy!r}", allowed=", ".join(get_args(ProxyName)))
        if self.stride_px < 1 or not 0 <= self.seed < 2**63:
            raise InputError(
                f"stride {self.stride_px} px, seed {self.seed}", allowed="a stride >= 1 px and a seed in [0, 2^63)"
            )
        if not 1 <= self.fits <= MOST_FITS:
            raise InputError(f"{self.fits} fits side by side", allowed=f"1 to {MOST_FITS}")
        self.decode.check()
        self.geometry.check()
        self.brightness.check()
        self.fit.check()
        if self.fine is not None:
            self.fine.check()
        self.residual.steps()
        self.raster.check()
        return self


@dataclass(frozen=True)
class Reconstruction:
    """What was recovered: the record of the run, and the Gaussians."""

    result: RunResult
    scene: Gaussians


@one_torch_thread()
def reconstruct(
    shot: Shot,
    settings: Settings | None = None,
    progress: Progress | None = None,
    score: Score | None = None,
    pace: Pace | None = None,
) -> Reconstruction:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: The measurement; its truth is not read.
        settings: Settings of every stage.
        progress: Told of every stage and step.
        score: Turns views, [N, H, W, C], into a figure for the curve, in dB; it may know the truth.
        pace: Decides how many iterations the fit has, instead of the settings.

    Returns:
        The best of three by the held-out pixels: the mean of the fits' views refined by its residual, the views of
        the best fit's scene, or the decode; and the other two.

    Raises:
        InputError: The shot's parts do not fit together, the settings make no sense, or poses are to come
            from telemetry that the shot does not hold.
        NumericsError: The first fit is not finite from its first iteration on.
    """
    settings, progress = settings or Settings(), progress or Silent()
    settings.check()
    lens = Lens.of(shot.check())
    tools = _Tools.load(settings)
    clock = _Stopwatch()
    sound, doubts = _examined(shot, progress)
    jury = Jury(sound, choose_heldout(sound, settings.fit.hold_out.share, settings.seed))

    first = look(jury, tools.geometry_prior, settings.look, progress, clock.lap, lens)
    jury, decoded = first.jury, first.decoded
    geometry, start = _beginning(first, lens, settings)
    clock.lap("geometry")

    fitted = Jury(fill_holes(jury.shot, decoded), jury.heldout)
    refine = Refinement(jury, settings.residual)

    def fit_one(member: Member, listener: Progress, own_pace: Pace | None) -> CoarseFit:
        return fit_coarse(
            jury=fitted,
            start=member.start,
            geometry=geometry,
            backend=through(lens, load_backend(settings.backend, settings.raster)),  # its buffers serve one at a time
            settings=replace(settings.fit, density=member.density),
            seed=member.seed,
            refine=refine.in_full,
            progress=listener,
            score=score,
            since_s=clock.began_s,
            pace=own_pace,
        )

    fits = fit_together(fit_one, members(start, settings.density_rules, settings.fits, settings.seed), progress, pace)
    renderer = ShotRenderer(fitted.shot, geometry.intrinsics, through(lens, tools.backend))
    if tools.fine is not None:
        clock.lap("fit")
        best = combined(fits, jury, refine).best
        fined = fit_fine(
            fitted, best, renderer, tools.fine, settings.seed, refine.in_full, progress, score, clock.began_s
        )
        fits = tuple(fined if fit is best else fit for fit in fits)
        clock.lap("fine")
    ensemble = combined(fits, jury, refine)
    recovered = _recover(jury, decoded, ensemble, refine)
    depth = renderer.depths(ensemble.best.scene, ensemble.best.world_to_camera)
    clock.lap("fit")
    left = _Left((*doubts, *first.notes), first, geometry, ensemble, depth, recovered)
    return Reconstruction(_record(shot, settings, left, score, clock.seconds()), ensemble.best.scene)


@dataclass(frozen=True)
class _Tools:
    """What the settings name, loaded before any time is spent on the measurement."""

    backend: Backend
    fine: Fine | None
    geometry_prior: GeometryPrior

    @classmethod
    def load(cls, settings: Settings) -> "_Tools":
        backend = load_backend(settings.backend, settings.raster)
        fine = None if settings.fine is None else Fine.load(settings.fine, settings.fit.loss, settings.seed)
        return cls(backend, fine, load_geometry_prior(settings.poses))


def _examined(shot: Shot, progress: Progress) -> tuple[Shot, tuple[str, ...]]:
    """Return the shot with its dead lines and hot pixels closed, and what is to be doubted about it."""
    alive, dead = close_dead_lines(shot)
    sound, hot = close_hot_pixels(alive)
    doubts = (*doubts_about(shot), *dead, *hot)
    for doubt in doubts:
        progress.say(doubt)
    return sound, doubts


def _beginning(first: FirstLook, lens: Lens | None, settings: Settings) -> tuple[Geometry, Gaussians]:
    """Get poses and Gaussians to start from, as far as the settings do not withhold them."""
    geometry = first_poses(first.geometry, settings.withheld)
    views = straightened(first.decoded, lens)
    start = first_gaussians(first_points(geometry, views, settings.stride_px, settings.withheld, settings.seed))
    # What is fitted and handed over counts the sensor's pixels, and no longer the canvas's.
    return (geometry if lens is None else replace(geometry, intrinsics=lens.intrinsics)), start


class _Stopwatch:
    """Wall-clock seconds by stage."""

    def __init__(self) -> None:
        self.began_s = self._lap_s = time.monotonic()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = time.monotonic()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._lap_s
        self._lap_s = now

    def seconds(self) -> dict[str, float]:
        return {**self._stages, "total": self._lap_s - self.began_s}


@dataclass(frozen=True)
class _Recovered:
    """The best of the candidates, and why."""

    views: F32
    verdict: Verdict
    heldout_rms: dict[Verdict, float | None]
    notes: tuple[str, ...]


def _recover(jury: Jury, decoded: F32, ensemble: Ensemble, refine: Refinement) -> _Recovered:
    """Let the held-out pixels choose between the refined views, the best scene's and the decode."""
    candidates: dict[Verdict, F32] = {
        "refined": refine(ensemble.views),
        "scene": ensemble.best.views,
        "decode": decoded,
    }
    heldout_rms = {name: jury.residual_rms(views) for name, views in candidates.items()}
    verdict = _judge(heldout_rms)
    notes = doubts_about_result(jury, candidates[verdict]) if jury.heldout.any() else (_UNJUDGED,)
    if verdict == "refined":  # the pixels that judged may now help as well
        candidates["refined"] = refine.by_all_pixels(ensemble.views)
    return _Recovered(candidates[verdict], verdict, heldout_rms, notes)


def _judge(heldout_rms: dict[Verdict, float | None]) -> Verdict:
    """Name the candidate with the smallest held-out residual; without any held-out pixels, the scene itself."""
    known = {name: rms for name, rms in heldout_rms.items() if rms is not None}
    return min(known, key=lambda name: known[name]) if known else "scene"


@dataclass(frozen=True)
class _Left:
    """What the stages left, in their order."""

    doubts: tuple[str, ...]
    look: FirstLook
    geometry: Geometry
    ensemble: Ensemble
    depth: F32
    recovered: _Recovered


def _record(shot: Shot, settings: Settings, left: _Left, score: Score | None, seconds: dict[str, float]) -> RunResult:
    geometry, fit, recovered = left.geometry, left.ensemble.best, left.recovered
    moved, brightness = movement(geometry.world_to_camera, fit.world_to_camera), left.look.brightness
    lit = replace(shot, weights=left.look.jury.shot.weights)
    return RunResult(
        views=recovered.views,
        scene_views=fit.views,
        decode=left.look.decoded,
        depth=left.depth,
        world_to_camera=fit.world_to_camera,
        intrinsics=geometry.intrinsics,
        distortion=shot.distortion,
        predicted_measurement=Coding.of(lit).forward(torch.from_numpy(recovered.views)).numpy(),
        curve=(*fit.curve, *_last_point(left, score, seconds["total"])),
        stopped_because=fit.stopped_because,
        seconds=seconds,
        gaussians=len(fit.scene),
        notes=(
            *(
                *left.doubts,
                *left.look.notes,
                *geometry.notes,
                *left.ensemble.notes,
                *_fits_missing(left.ensemble, settings),
            ),
            *(*_notes_of(moved, geometry.source), *recovered.notes),
        ),
        settings=asdict(settings),
        seed=settings.seed,
        verdict=recovered.verdict,
        heldout_rms=recovered.heldout_rms,
        geometry={**_summary(geometry, settings), "moved": asdict(moved)},
        ensemble=left.ensemble.summary(),
        disagreement=left.ensemble.disagreement,
        brightness=None if brightness is None else brightness.tolist(),
    ).check()


def _fits_missing(ensemble: Ensemble, settings: Settings) -> tuple[str, ...]:
    there = 1 + len(ensemble.others)
    if there == settings.fits:
        return ()
    return (f"{there} of {settings.fits} fits came to an end: the others left the finite numbers, or found no time.",)


def _last_point(left: _Left, score: Score | None, seconds: float) -> tuple[CurvePoint, ...]:
    """Return the point at which the mean of several fits ends the curve of one; none where it is no mean."""
    fit, recovered = left.ensemble.best, left.recovered
    if left.ensemble.averaged == 1 or recovered.verdict != "refined" or not fit.curve:
        return ()
    heldout, psnr_db = recovered.heldout_rms["refined"], None if score is None else score(recovered.views)
    return (replace(fit.curve[-1], seconds=seconds, heldout=heldout, psnr_db=psnr_db),)


def _notes_of(moved: Movement, source: str) -> tuple[str, ...]:
    if source == "tracks":
        return ()
    share, rotation_deg = moved.share_of_path, moved.rotation_deg
    return (f"The fit moved the poses of the {source} by {share:.1%} of the path and {rotation_deg:.3f}°.",)


def _summary(geometry: Geometry, settings: Settings) -> dict[str, object]:
    return {
        "method": geometry.source,
        "asked_for": settings.poses,
        "proxy": settings.proxy,
        "verdict": geometry.verdict,
        "focal_px": float(geometry.intrinsics[0, 0]),
        "focal_source": geometry.focal_source,
        "tracks": geometry.tracks,
        "reprojection_rms_px": geometry.reprojection_rms_px,
        "parallax_px": geometry.parallax_px,
        "path_error_expected": geometry.path_error_expected,
        "reference": geometry.reference,
    }
