"""Exposures observed one by one, each as a measurement of its own, before they share a scene.

Here: the record of an observed exposure, and how several are observed. Not here: what an observation is (`observe`),
how exposures come into common coordinates (`placing`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.placing import moved, placed
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Untied
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses.fitting import Fits
from gs2ci.reconstruct.measurement.lens import straightened
from gs2ci.reconstruct.observe import Observed, Tools, observe
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend


@dataclass(frozen=True, eq=False)
class ObservedExposure:
    """What is known of one exposure before anything is fitted.

    Args:
        number: Its place among those given.
        name: Its name.
        again: Returns the measurement, its decoded views, path and depth, in its own coordinates; from memory, or from
            a disk that keeps them, so that only those in work take memory.
        given: The measurement as it was given.
        repeats: The number of the exposure whose path it repeats, its own for the first of such a group; None: of none.
    """

    number: int
    name: str
    again: Callable[[], Observed]
    given: Shot
    repeats: int | None = None

    @property
    def observed(self) -> Observed:
        """Get the measurement, its decoded views, path and depth, in its own coordinates."""
        return self.again()

    @property
    def geometry(self) -> Geometry:
        """Get its path and depth, in its own coordinates."""
        return self.observed.first.geometry

    @property
    def shot(self) -> Shot:
        """Get its measurement, registered."""
        return self.observed.registered.shot

    def untied(self) -> Untied:
        """Return what exposures without telemetry are tied by."""
        observed = self.observed
        views = straightened(observed.first.decoded, observed.fits.lens)
        return Untied(self.name, np.clip(views, 0, 1).astype(np.float32, copy=False), observed.first.geometry)

    def in_common(self, common_from_own: Similarity, geometry: Geometry | None = None) -> "CommonPlace":
        """Return where it is in common coordinates, with its first Gaussians.

        Args:
            common_from_own: The similarity from its own coordinates.
            geometry: A better path and depth in its own coordinates; None: as observed.
        """
        observed = self.observed
        fits, first = observed.fits, observed.first
        look = first if geometry is None else replace(first, geometry=geometry)
        geometry, start = fits.beginning(look, first.decoded)
        return CommonPlace(self.number, placed(geometry, common_from_own), moved(start, common_from_own))


@dataclass(frozen=True, eq=False)
class CommonPlace:
    """Where an exposure is in common coordinates.

    Args:
        number: Its place among those given.
        geometry: Its path and depth, the camera matrix in pixels of the sensor.
        start: Its first Gaussians.
    """

    number: int
    geometry: Geometry
    start: Gaussians


@dataclass(frozen=True, eq=False)
class PlacedExposure:
    """An exposure in common coordinates: as it was observed, and where it is."""

    of: ObservedExposure
    at: CommonPlace

    def renderer(self, fits: Fits, backend: Backend) -> ShotRenderer:
        """Return a renderer of its measurement, of which `fits` are."""
        return ShotRenderer(fits.fitted.shot, self.at.geometry.intrinsics, backend, fits.lens, fits.mask_moments)

    def to_fit(self, backend: Backend) -> FittedExposure:
        """Return what a fit is given for it; exposures of a fit share a backend, whose buffers serve one at a time."""
        fits = self.of.observed.fits
        return FittedExposure(
            fits.fitted, self.renderer(fits, backend), self.at.geometry, fits.refine.decode, fits.score
        )


def held(observed: Observed) -> Callable[[], Observed]:
    """Return what returns an observation from memory."""
    return lambda: observed


Keeping = Callable[[int, Shot, Settings, Score | None], Callable[[], Observed]]
"""Observes an exposure of a number, unless that is done, and keeps the observation; returns what returns it."""


def observe_all(
    shots: Sequence[Shot],
    settings: Settings,
    tools: Tools,
    progress: Progress,
    scores: Sequence[Score | None],
    keeping: Keeping | None = None,
) -> Iterator[ObservedExposure]:
    """Observe exposures of one camera in turn; arguments and errors as of `joint.reconstruct_together`.

    Where the camera matrix is not known, that estimated for the first exposure is taken for all. Pixels are held out by
    draws of each exposure's own, so that repeats of a path do not hold out the same. `keeping` observes them and keeps
    what was found; None: in memory.
    """

    def in_memory(number: int, shot: Shot, settings: Settings, score: Score | None) -> Callable[[], Observed]:
        return held(observe(shot, settings, tools, progress, score, Halt(), None))

    intrinsics = shots[0].intrinsics
    for number, (shot, score) in enumerate(zip(shots, scores, strict=True)):
        own = replace(settings, seed=_seed(settings.seed, number))
        given = shot if shot.intrinsics is not None or intrinsics is None else replace(shot, intrinsics=intrinsics)
        observed = (keeping or in_memory)(number, given, own, score)
        if intrinsics is None:
            intrinsics = observed().first.geometry.intrinsics
        yield ObservedExposure(number, shot.name, observed, shot)


def _seed(seed: int, number: int) -> int:
    """Return the seed of an exposure: the given one for the first."""
    if number == 0:
        return seed
    return int(np.random.SeedSequence([seed, 0xE1, number]).generate_state(1, np.uint64)[0] >> 1)
