"""Brief fits of a plane seen by a moving camera, and backends and listeners that watch or disturb them."""

import itertools

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring, nothing
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stage import CoarseRun
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import first_gaussians
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.settings import RasterSettings

# Surfaces have tests of their own: those of the loop count its renderings.
QUICK = CoarseSettings(iterations=60, densify_every=20, surfaces=None, hold_out=HoldOut(share=0.05, look_every=10))
UNJUDGED = HoldOut(share=0.0, look_every=10, patience=10**6, growth_patience=10**6)


def fit_coarse(exposure, start, settings, seed, monitoring):
    """Fit one exposure without a pause."""
    fit = CoarseRun([exposure], start, settings, seed, monitoring)
    fit.advance()
    return fit.result()


def run(
    moving_plane,
    settings=QUICK,
    *,
    backend=None,
    seed=0,
    listener=None,
    score=None,
    shot=None,
    pace=None,
    decode=nothing,
    mask_moments=None,
):
    fit, holdout = paused(
        moving_plane,
        settings,
        backend=backend,
        seed=seed,
        listener=listener,
        score=score,
        shot=shot,
        pace=pace,
        decode=decode,
        mask_moments=mask_moments,
    )
    fit.advance()
    return fit.result(), holdout


def paused(
    moving_plane,
    settings=QUICK,
    *,
    backend=None,
    seed=0,
    listener=None,
    score=None,
    shot=None,
    pace=None,
    decode=nothing,
    mask_moments=None,
):
    """Return a fit that has not begun."""
    given, geometry = moving_plane
    shot = shot or given
    holdout = Holdout.of(shot, settings.hold_out.share, seed)
    grey = np.full((*shot.masks.shape, shot.channels), 0.5, np.float32)
    renderer = ShotRenderer(shot, geometry.intrinsics, backend or CpuBackend(), mask_moments=mask_moments)
    fit = CoarseRun(
        [FittedExposure(holdout, renderer, geometry, decode, score)],
        start=first_gaussians(seed_points(geometry, grey, 2)),
        settings=settings,
        seed=seed,
        monitoring=Monitoring(listener or Silent()),
        pace=pace,
    )
    return fit, holdout


class FaultyBackend(CpuBackend):
    """Gives gradients that are NaN in the iterations that `when` tells by their number; looks do not count."""

    def __init__(self, when):
        super().__init__()
        self._when = when
        self._calls = itertools.count()

    def coded_with_pull(self, *arguments):
        image, pull = super().coded_with_pull(*arguments)

        def spoiled(gradient):
            return pull(gradient * np.float32("nan") if self._when(next(self._calls)) else gradient)

        return image, spoiled


class Watching(CpuBackend):
    """Keeps lists, and remembers which population was rendered with which of them."""

    def __init__(self, every, when_faulty=lambda call: False):
        super().__init__(RasterSettings(relist_every=every))
        self.given = []
        self.populations = {}
        self._when_faulty = when_faulty
        self._calls = itertools.count()

    def coded_with_pull(self, scene, world_to_camera, intrinsics, coding, screen, reuse):
        if reuse is None:  # a look
            return super().coded_with_pull(scene, world_to_camera, intrinsics, coding, screen, reuse)
        if reuse not in self.given:
            self.given.append(reuse)
        self.populations.setdefault(reuse, set()).add(scene.means.data_ptr())
        image, pull = super().coded_with_pull(scene, world_to_camera, intrinsics, coding, screen, reuse)
        faulty = self._when_faulty(next(self._calls))
        return image, lambda gradient: pull(gradient * np.float32("nan") if faulty else gradient)


class Listener(Silent):
    def __init__(self):
        super().__init__()
        self.steps = []

    def step(self, done, **figures):
        self.steps.append((done, figures))
