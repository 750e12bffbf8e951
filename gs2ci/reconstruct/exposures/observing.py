"""Exposures observed one by one, each as a measurement of its own, before they share a scene.

Here: the record of an observed exposure, how several are observed, and how they come into common coordinates. Not here:
what an observation is (`observe`), where exposures lie (`places`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
import torch

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.halt import Halt
from gs2ci.core.lens import seen_by
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Untied
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.combining.ensemble import member_seed
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource
from gs2ci.reconstruct.hypotheses.fitting import Fits
from gs2ci.reconstruct.measurement.lens import straightened
from gs2ci.reconstruct.observe import Observed, Tools, observe
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.gaussians import Gaussians, joined
from gs2ci.render.interface import Backend

# Exposures in common coordinates: paths, depths and first Gaussians brought there, and the tie by a stage.
#
# Each exposure alone has the axes of its own reference view and the median depth of its own scene as its unit. The
# common coordinates are those of the first exposure.


def placed(geometry: Geometry, common_from_own: Similarity) -> Geometry:
    """Return a geometry in the common coordinates."""
    scale, errors = common_from_own.scale, geometry.pose_errors
    return replace(
        geometry,
        world_to_camera=common_from_own.poses(geometry.world_to_camera),
        inverse_depth=(geometry.inverse_depth / scale).astype(np.float32),
        view_depths=tuple(
            replace(one, inverse_depth=(one.inverse_depth / scale).astype(np.float32)) for one in geometry.view_depths
        ),
        unit=None if geometry.unit is None else geometry.unit / scale,
        pose_errors=None if errors is None else replace(errors, position=errors.position * scale),
        other_order=None,
    )


def by_stage(shots: Sequence[Shot], geometries: Sequence[Geometry]) -> dict[int, Similarity]:
    """Return common_from_own of the exposures whose paths a stage gave, by index.

    The common coordinates are those of the first of them. A stage reports all exposures of a session in one frame and
    one unit, and each single path was checked against its own views before it was taken (`geometry.choose`).
    """
    known = {
        number: (shot.telemetry_world_to_camera[geometry.reference], geometry.unit)
        for number, (shot, geometry) in enumerate(zip(shots, geometries, strict=True))
        if geometry.source == PathSource.STAGE
        and shot.telemetry_world_to_camera is not None
        and geometry.unit is not None
    }
    if not known:
        return {}
    first, unit = known[min(known)]
    found = {}
    for number, (pose, own) in known.items():
        between = first @ np.linalg.inv(pose)
        found[number] = Similarity(own / unit, between[:3, :3], between[:3, 3] / unit)
    return found


def first_of_all(starts: Sequence[Gaussians], geometries: Sequence[Geometry]) -> tuple[Gaussians, float]:
    """Join the first Gaussians of exposures; of each, those that no earlier exposure's reference view shows.

    Args:
        starts: Of each exposure, in common coordinates.
        geometries: Likewise.

    Returns:
        The Gaussians, and how many times as many there are as in the first exposure alone.
    """
    parts = []
    for number, scene in enumerate(starts):
        new = torch.from_numpy(~_shown(scene.means.double().numpy(), geometries[:number]))
        parts.append(scene.map(itemgetter(new)))
    together = joined(parts)
    return together, len(together) / len(parts[0])


def moved(scene: Gaussians, common_from_own: Similarity) -> Gaussians:
    """Return round Gaussians in the common coordinates."""
    means = common_from_own.points(scene.means.double().numpy())
    log_scales = scene.log_scales + math.log(common_from_own.scale)
    return replace(scene, means=torch.from_numpy(means).float(), log_scales=log_scales)


def _shown(points: F64, geometries: Sequence[Geometry]) -> Bool:
    """Tell which points, [P, 3], the reference views of geometries show in their pictures."""
    found = np.zeros(len(points), bool)
    for one in geometries:
        found |= seen_by(points, one.world_to_camera[one.reference], one.intrinsics, one.inverse_depth.shape)[0]
    return found


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
    draws of each exposure's own, so that repeats of a path do not hold out the same; under the same masks they do: one
    would tell the other's reading there. `keeping` observes them and keeps what was found; None: in memory.
    """

    def in_memory(number: int, shot: Shot, settings: Settings, score: Score | None) -> Callable[[], Observed]:
        return held(observe(shot, settings, tools, progress, score, Halt(), None))

    intrinsics = shots[0].intrinsics
    for number, (shot, score) in enumerate(zip(shots, scores, strict=True)):
        drawn = next(k for k, other in enumerate(shots) if np.array_equal(other.masks, shot.masks))
        own = replace(settings, seed=member_seed(settings.seed, drawn, 0xE1))
        given = shot if shot.intrinsics is not None or intrinsics is None else replace(shot, intrinsics=intrinsics)
        observed = (keeping or in_memory)(number, given, own, score)
        if intrinsics is None:
            intrinsics = observed().first.geometry.intrinsics
        yield ObservedExposure(number, shot.name, observed, shot)
