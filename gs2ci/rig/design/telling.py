"""What the coding of exposures tells of the wanted views: Gauss-Newton on a simulated scene, without a reconstruction.

About a place of the scene, the readings are linear in its texture, and to first order in its depth:

    y(p) = Σ_n M_n(p) T(p − u_n),    ∂y(p)/∂ln z = −Σ_n M_n(p) ∇T(p − u_n) · ∂u_n/∂ln z

with u_n the flow from the middle view to that under mask n. Their normal matrix JᵀJ, with the noise of each reading and
what is known of textures beforehand, gives the error of texture and depth together, and so that of every wanted view:
what the masks leave open of the texture, what a wrong depth displaces (the more, the farther the view lies from those
recorded), and what no recorded view shows. Unlike `gs2ci.reconstruct.uncertainty.information`, which asks for depths
and poses of a scene whose look is taken from its views, texture is unknown here: how well it is determined is what
masks differ by.

Of the decode's error, from which path and depth begin, some is kept (`decode`).
What a fitted scene cannot show counts as noise, too, alike in views between which the picture hardly moves.

Here: the wanted views, places all over them, what no recorded view shows. Not here: one place (`place`), the decode
(`decode`), the exposures (`exposing`), real reconstructions (`gs2ci.evaluate.design`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import in_world
from gs2ci.core.errors import InputError
from gs2ci.core.lens import pixel_centres, rays_of, seen_by
from gs2ci.rig.config import CaptureTable
from gs2ci.rig.design.decode import KEPT, error_of_decode
from gs2ci.rig.design.exposing import SmallBench, middles
from gs2ci.rig.design.place import REPRESENTED, SIDE_PX, Place, Readings, Texture, flows

# Places that are looked at, along rows and columns of the picture.
_PLACES: Final = (4, 5)
# Views along the wanted path.
_WANTED: Final = 5
# A wanted pixel is seen in a recorded view if that view's depth there is less than this share nearer.
_HIDDEN: Final = 0.05


@dataclass(frozen=True, eq=False)
class WantedViews:
    """The views that are wanted of a scene.

    Args:
        poses: [S, 4, 4].
        views: [S, H, W, C].
        depth: [S, H, W]; 0 where nothing is.
    """

    poses: F64
    views: F32
    depth: F32

    @property
    def middle(self) -> int:
        """Get the number of the view in whose pixels texture is asked for."""
        return len(self.poses) // 2


def wanted_views(bench: SmallBench, own: CaptureTable, wanted_mm: float | None) -> WantedViews:
    """Render the views that are wanted of a scene.

    Args:
        bench: The bench before it.
        own: The rig file's [capture].
        wanted_mm: Along how much of the path they lie; None: along the rig file's travel.

    Raises:
        InputError: A length for a camera that does not move.
    """
    if wanted_mm is not None and not own.axis:
        raise InputError(
            f"views along {wanted_mm:g} mm of a path on a bench whose [capture] names no axis",
            remedy="set axis, from_mm and to_mm in [capture], or leave --wanted-mm out",
        )
    half = 0.5 if wanted_mm is None or own.from_mm == own.to_mm else wanted_mm / abs(own.to_mm - own.from_mm) / 2
    shares = np.linspace(0.5 - half, 0.5 + half, _WANTED) if own.axis else np.array([0.5])
    poses = bench.poses(own, shares)
    return WantedViews(poses, *bench.seen(poses))


@dataclass(frozen=True)
class Told:
    """The power of the error that is foreseen in the wanted views, in parts; full scale 1.

    Args:
        texture: What the masks leave open.
        depth: What wrong depths displace, beyond that.
        unseen: Of what no recorded view shows.
        decoded: What is left of the decode's error, from which path and depth begin.
        saturated: Share of the readings that are clipped.
    """

    texture: float
    depth: float
    unseen: float
    decoded: float
    saturated: float

    @property
    def psnr_db(self) -> float:
        """Get the expected peak signal-to-noise ratio of the wanted views, dB."""
        return float(-10 * np.log10(REPRESENTED**2 + self.texture + self.depth + self.unseen + self.decoded))


def told(bench: SmallBench, wanted: WantedViews, of: Readings) -> Told:
    """Foresee how far the wanted views will err.

    Args:
        bench: The bench before the scene.
        wanted: The views that are wanted.
        of: The readings.
    """
    picture = wanted.views[wanted.middle].mean(axis=-1, dtype=np.float64)
    prior = Texture.of(picture)
    found = [_place(bench, wanted, of, row, column) for row, column in _places(picture.shape)]
    places = [place for place in found if place is not None]
    share = _unseen_share(bench, wanted, of)
    unseen = share * prior.variance
    if not places:
        return Told(0.0, 0.0, unseen, 0.0, 0.0)
    errors = [place.errors(picture, of, prior) for place in places]
    return Told(
        (1 - share) * float(np.mean([one.texture for one in errors])),
        (1 - share) * float(np.mean([one.depth for one in errors])),
        unseen,
        KEPT * error_of_decode(places, of, prior, float(picture.mean())),
        float(np.mean([one.clipped for one in errors])),
    )


def _places(size: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return the middle pixels of places all over a picture."""
    rows, columns = ((np.arange(number) + 0.5) * side / number for side, number in zip(size, _PLACES, strict=True))
    return [(int(row), int(column)) for row in rows for column in columns]


def _place(bench: SmallBench, wanted: WantedViews, of: Readings, row: int, column: int) -> Place | None:
    """Return the place about a pixel; None if nothing is there."""
    half = SIDE_PX // 2
    depths = wanted.depth[wanted.middle, row - half : row + half, column - half : column + half]
    if not (depths > 0).any():
        return None
    depth = float(np.median(depths[depths > 0]))
    matrix, middle = bench.scene.intrinsics, wanted.poses[wanted.middle]
    moved, by_depth = flows(matrix, middle, of.poses, row, column, depth)
    _, wanted_by_depth = flows(matrix, middle, wanted.poses, row, column, depth)
    return Place(row - half, column - half, moved, by_depth, wanted_by_depth)


def _unseen_share(bench: SmallBench, wanted: WantedViews, of: Readings) -> float:
    """Return the share of the wanted views' pixels that neither the first nor the last recorded view shows."""
    hidden = [
        ((depth > 0) & ~_shown(bench, of, pose, depth)).mean()
        for pose, depth in zip(wanted.poses, wanted.depth, strict=True)
    ]
    return float(np.mean(hidden))


def _shown(bench: SmallBench, of: Readings, pose: F64, depth: F32) -> Bool:
    """Return which pixels of a wanted view the first or the last recorded view shows, [H, W]."""
    matrix = bench.scene.intrinsics
    rays = rays_of(pixel_centres(depth.shape), matrix)
    points = in_world((rays * depth[..., None]).reshape(-1, 3), pose)
    found = np.zeros(depth.size, bool)
    for recorded, surface in zip(of.poses[[0, -1]], of.depth, strict=True):
        inside, ahead, places = seen_by(points, recorded, matrix, depth.shape)
        column, row = np.where(inside[:, None], places, 0).astype(np.int64).T
        here = surface[row, column]
        found |= inside & ((here <= 0) | (ahead <= here * (1 + _HIDDEN)))
    return found.reshape(depth.shape)


def readings_of(bench: SmallBench, capture: CaptureTable, exposures: int) -> Readings:
    """Return what is to be known of exposures before they are taken.

    Args:
        bench: The bench before the scene.
        capture: What is taken.
        exposures: How many, each beginning with another mask.

    Raises:
        InputError: The masks cannot be drawn.
    """
    poses = bench.poses(capture, middles(capture.masks))
    sensor = bench.light.nominal_rig(bench.bits).sensor
    return Readings(
        np.stack([bench.masks(capture, index) for index in range(exposures)]),
        capture.element,
        poses,
        bench.seen(poses[[0, -1]])[1],
        bench.full_scale_e(capture),
        sensor.full_well_e,
        sensor.read_noise_e**2 + sensor.electrons_per_dn**2 / 12,
    )
