"""Predicting the seconds of a reconstruction on this machine: measured on a crop of the shot, then scaled.

Here: the probe and the model. Not here: the trials (`trials`).

Each stage runs for a moment on a crop of the shot with its own masks, twice with different sizes, so that the fixed and
the growing part of its time are known:

    decode    steps × view-pixels
    geometry  sources tried × view-pixels × (fixed + planes of the sweep)
    fit       iterations × (view-pixels + views × Gaussians)
    a look    view-pixels (an evaluation on the held-out pixels)

Fits side by side share the threads that one fit was measured with, as far as an iteration uses more than one.
Windows, and what the rasteriser may leave out (`RasterSettings`), are not in the model: settings that differ only in
these have the same prediction. Reusing lists of Gaussians makes an iteration up to a fifth cheaper than predicted.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numba
import numpy as np
from scipy.ndimage import gaussian_filter, shift

from gs2ci.core.arrays import F32
from gs2ci.core.cameras import pinhole
from gs2ci.core.crop import middle_of
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.decode.by_name import patch_settings
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, gap_tv
from gs2ci.reconstruct.decode.residual import ResidualSettings, decode_left_over
from gs2ci.reconstruct.fit.coarse import fit_coarse
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.looks import Monitoring
from gs2ci.reconstruct.fit.pace import LOOKS_AFTERWARDS, Timed, slower_beside
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import HoldOut
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, sweep
from gs2ci.reconstruct.geometry.initialise import Geometry, GeometrySettings, initialise
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import HELDOUT_SHARE, Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci.render.interface import Backend

# Large enough to fill every thread, small enough for the whole probe to take a second or two.
_CROP_VIEW_PIXELS: Final = 400_000
_WARM_VIEW_PIXELS: Final = 20_000
_LEAST_SIDE: Final = 32
_STRIDES: Final = (6, 2)
_STEPS: Final = (1, 5)
_SWEEP: Final = SweepSettings(planes=24)
_ITERATIONS: Final = 4
# A plane at rest, as the probe fits it, renders faster than a scene that has been fitted: per iteration by 1.35 to
# 1.8 in processor time, on a scene of 18,000 to 37,000 Gaussians.
_THAN_A_PLANE: Final = 1.5
# An iteration of the patch decoder, in GAP steps: 0.69 s of processors against 2.6 ms on 256 x 256 px x 8 views
# (`python -m tests.benchmarks video`).
_PATCH_ITERATION: Final = 260.0
# An iteration of the fine stage, in iterations of the coarse stage with as many Gaussians.
_FINE_ITERATION: Final = 2.0
# A population grows by about a fifth at each turn of the density rule, until it reaches its cap.
_GROWTH_PER_TURN: Final = 1.18
# Initial Gaussians for each pixel of the stride's grid: the grid, and the borders that only other views see.
_RIMS: Final = 1.1
# Without a cap on the population: the number that `paper` reached on a simulated scene, rounded up, 9,898 Gaussians for
# 3,072 pixels (`python -m tests.benchmarks population`).
_UNBOUNDED_PER_PIXEL: Final = 4.0


@dataclass(frozen=True)
class Seconds:
    """The expected seconds of the parts of a reconstruction.

    Args:
        decode: The decode.
        geometry: Tracks, motion and depth.
        fit: The iterations and the evaluations on held-out pixels, if the fit runs to its end, and the fine stage.
        finish: The steps after the last evaluation, without the report.
    """

    decode: float
    geometry: float
    fit: float
    finish: float

    @property
    def total(self) -> float:
        """Get the sum."""
        return self.decode + self.geometry + self.fit + self.finish


@dataclass(frozen=True)
class CostModel:
    """Measured unit costs, in seconds, for one shot on this machine.

    Args:
        pixels: Pixels of one view of the shot.
        views: N.
        decode_step: One GAP step on all views.
        geometry: Geometry of the whole shot without planes.
        plane: One plane of the sweep on the whole shot.
        iteration: One iteration of the fit without Gaussians.
        gaussian: Addition to that for each Gaussian.
        look: One evaluation on the held-out pixels.
        threads: Number of threads with which an iteration was measured.
        sources: How many sources of geometry are tried for a choice by evidence: two if a stage reported poses. A model
            that the user added is not included.
    """

    pixels: int
    views: int
    decode_step: float
    geometry: float
    plane: float
    iteration: float
    gaussian: float
    look: float
    threads: int = 1
    sources: int = 1

    def predict(self, settings: Settings) -> Seconds:
        """Predict the time of a reconstruction of the shot."""
        fit = settings.fit
        shares = (np.arange(32) + 0.5) / 32
        each = float(np.mean([self.iteration_s(settings, float(share)) for share in shares]))
        looks = math.ceil(fit.iterations / fit.hold_out.look_every)
        asked = self.sources if settings.poses == "auto" else 1
        return Seconds(
            decode=self._decode_steps(settings) * self.decode_step,
            geometry=asked * (self.geometry + settings.geometry.sweep.planes * self.plane),
            fit=fit.iterations * each + looks * self.look + self._fine_s(settings),
            finish=LOOKS_AFTERWARDS * self.look,
        )

    def _decode_steps(self, settings: Settings) -> float:
        """Count the steps of the first look, in GAP steps."""
        patches = patch_settings(settings.first_look, settings.decode)
        return settings.decode.iterations + (_PATCH_ITERATION * patches.iterations if patches else 0.0)

    def _fine_s(self, settings: Settings) -> float:
        """Predict what the fine stage takes: beside the measurement, each iteration renders one whole view."""
        if settings.fine is None:
            return 0.0
        looks = math.ceil(settings.fine.iterations / settings.fine.hold_out.look_every)
        return settings.fine.iterations * _FINE_ITERATION * self.iteration_s(settings, 1.0) + looks * self.look

    def iteration_s(self, settings: Settings, share: float) -> float:
        """Predict what one iteration takes when a share of the schedule is done, without looks.

        With several fits side by side, one of each.
        """
        alone = self.iteration + self.population(settings, share) * self.gaussian
        return alone * slower_beside(settings.fits, self.threads)

    def population(self, settings: Settings, share: float) -> float:
        """Predict how many Gaussians there are when a share of the schedule is done."""
        fit = settings.fit
        first = _RIMS * self.pixels / settings.stride_px**2
        per_pixel = _UNBOUNDED_PER_PIXEL if fit.gaussians_per_pixel is None else fit.gaussians_per_pixel
        bound = per_pixel * self.pixels
        last = max(first, bound)
        growing = max(0.0, min(share, fit.densify_until) - fit.densify_from)
        turns = growing * fit.iterations / fit.densify_every
        # After some thousand turns every population has reached its cap, and powers would overflow.
        return float(min(last, first * _GROWTH_PER_TURN ** min(turns, 1000.0)))


def probe(shot: Shot, backend: str = "cpu") -> CostModel:
    """Measure the unit costs on a crop of a shot, in a second or two; kernels not yet compiled add their time.

    Raises:
        InputError: The shot's parts do not fit together, or there is no such backend.
    """
    shot.check()
    renderer = load_backend(backend)
    _probe_crop(_crop(shot, _WARM_VIEW_PIXELS), renderer)  # loads kernels and libraries
    crop = _crop(shot, _CROP_VIEW_PIXELS)
    found = _probe_crop(crop, renderer)
    pixels = shot.size[0] * shot.size[1]
    larger = pixels / found.pixels
    return CostModel(
        pixels=pixels,
        views=shot.views,
        decode_step=larger * found.decode_step,
        geometry=larger * found.geometry,
        plane=larger * found.plane,
        iteration=_THAN_A_PLANE * larger * found.iteration,
        gaussian=_THAN_A_PLANE * found.gaussian,
        look=_THAN_A_PLANE * larger * found.look,
        threads=numba.get_num_threads(),
        sources=1 if shot.telemetry_world_to_camera is None else 2,
    )


def _probe_crop(shot: Shot, backend: Backend) -> CostModel:
    """Measure every stage on a small shot."""
    decode_s = [_timed(partial(gap_tv, shot, GapTvSettings(iterations=steps))) for steps in _STEPS]
    views = _moving_texture((shot.views, *shot.size, shot.channels))
    geometry = _plane(shot)
    found_s = _timed(lambda: initialise(views, geometry.intrinsics, GeometrySettings(sweep=_SWEEP)))
    swept_s = _timed(lambda: _sweep(views, geometry))
    fits = [_probe_fit(shot, views, stride, backend) for stride in _STRIDES]
    (few, few_s, _), (many, many_s, look_s) = fits
    decode_step = _slope(decode_s, _STEPS)
    gaussian = max(0.0, many_s - few_s) / max(1, many - few)
    return CostModel(
        pixels=shot.size[0] * shot.size[1],
        views=shot.views,
        decode_step=decode_step,
        geometry=max(0.0, found_s - swept_s),
        plane=swept_s / _SWEEP.planes,
        iteration=max(few_s - few * gaussian, 0.1 * few_s),
        gaussian=gaussian,
        look=look_s,
    )


def _sweep(views: F32, geometry: Geometry) -> None:
    if len(views) < 2:  # a single view is not swept
        return
    sweep(views, geometry.world_to_camera, geometry.intrinsics, geometry.reference, (0.5, 1.5), _SWEEP)


def _probe_fit(shot: Shot, views: F32, stride: int, backend: Backend) -> tuple[int, float, float]:
    """Fit a plane for a few iterations; return Gaussians, the shortest seconds of an iteration, those of a look."""
    geometry = _plane(shot)
    start = first_gaussians(seed_points(geometry, views, stride))
    watch = Timed(_ITERATIONS)
    fit_coarse(
        holdout=Holdout.of(shot, HELDOUT_SHARE, 0),
        renderer=ShotRenderer(shot, geometry.intrinsics, backend),
        start=start,
        geometry=geometry,
        settings=CoarseSettings(iterations=_ITERATIONS, densify_from=1.0, hold_out=HoldOut(look_every=_ITERATIONS)),
        seed=0,
        monitoring=Monitoring(lambda coded: decode_left_over(shot, coded, ResidualSettings())),
        pace=watch,
    )
    return len(start), watch.iteration_s, watch.look_s


def _plane(shot: Shot) -> Geometry:
    """Put the shot's scene on a plane before a camera that stands still."""
    return Geometry(
        world_to_camera=np.tile(np.eye(4), (shot.views, 1, 1)),
        intrinsics=pinhole(max(shot.size), shot.size),
        focal_source="default",
        inverse_depth=np.ones(shot.size, np.float32),
        reference=shot.views // 2,
        tracks=0,
        reprojection_rms_px=0.0,
        parallax_px=0.0,
        verdict=Verdict.STATIC,
        notes=(),
    )


def _moving_texture(shape: tuple[int, int, int, int]) -> F32:
    """Make views of textured stripes at two depths, [N, H, W, C], in which the geometry stage finds its way."""
    count, height, width, channels = shape
    rng = np.random.default_rng(0)
    texture = gaussian_filter(rng.random((2, height, width)), (0, 1.5, 1.5))
    texture = (texture - texture.min()) / max(np.ptp(texture), 1e-9)
    near = (np.arange(height) // 16 % 2 == 0)[:, None]
    moves = 0.5 * (np.arange(count) - count // 2)
    views = [
        np.where(
            near,
            shift(texture[0], (0, -3 * move), order=1, mode="wrap"),
            shift(texture[1], (0, -move), order=1, mode="wrap"),
        )
        for move in moves
    ]
    return np.repeat(np.stack(views)[..., None], channels, axis=3).astype(np.float32)


def _crop(shot: Shot, view_pixels: int) -> Shot:
    """Cut the middle out of a shot, without the poses, intrinsics and truth that would spare the stages their work."""
    cropped = replace(
        middle_of(shot, view_pixels, _LEAST_SIDE),
        intrinsics=None,
        distortion=None,
        telemetry_world_to_camera=None,
        truth=Truth(),
    )
    try:
        return cropped.check()
    except InputError:  # a crop whose masks are all closed: the whole shot is dark there, and its size is what counts
        return replace(cropped, masks=np.ones_like(cropped.masks)).check()


def _timed(work: Callable[[], object]) -> float:
    began_s = time.monotonic()
    work()
    return time.monotonic() - began_s


def _slope(seconds: list[float], sizes: tuple[int, int]) -> float:
    """Return seconds per unit of size, at least a hundredth of the larger's mean: noise may make the slope negative."""
    rise = (seconds[1] - seconds[0]) / (sizes[1] - sizes[0])
    return max(rise, 0.01 * seconds[1] / sizes[1])
