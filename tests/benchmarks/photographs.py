"""Photographs on planes, seen by a pinhole: measurements of known truth, made without a Gaussian renderer.

Here: scikit-image's sample photographs as cards and balls in space, ray traced with nine rays per pixel, their true
depth, and coded exposures of cards. Not here: figures.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import skimage.data
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from tests.tables.beside import beside_path

_RAYS = 3
"""A side of the lattice of rays in a pixel."""


@dataclass(frozen=True)
class Card:
    """A photograph on a rectangle in space.

    Args:
        picture: [h, w, 3] float64, 0 to 1.
        corner: Of its upper left corner, [3]; x right, y down, z forward.
        right: From there to the upper right corner, [3].
        down: From there to the lower left corner, [3].
    """

    picture: F64
    corner: F64
    right: F64
    down: F64

    def met(self, origin: F64, rays: F64) -> tuple[F64, F64, F64]:
        """Return how far along rays [H, W, 3] it is met, and where in the picture, from 0 to 1: right and down."""
        # origin + t ray = corner + u right + v down
        normal = np.cross(self.right, self.down)
        t = ((self.corner - origin) @ normal) / (rays @ normal)
        across = origin + t[..., None] * rays - self.corner
        u, v = ((across @ side) / (side @ side) for side in (self.right, self.down))
        return t, u, v


@dataclass(frozen=True)
class Ball:
    """A ball on which a photograph is projected along z: its picture, as a card's, centre [3] and radius."""

    picture: F64
    centre: F64
    radius: float

    def met(self, origin: F64, rays: F64) -> tuple[F64, F64, F64]:
        """As of a card; t is NaN where the ball is passed."""
        away, square = self.centre - origin, np.square(rays).sum(axis=-1)
        along = rays @ away
        with np.errstate(invalid="ignore"):
            t = (along - np.sqrt(along**2 - square * (away @ away - self.radius**2))) / square
        place = (origin + t[..., None] * rays - self.centre) / (2 * self.radius) + 0.5
        return t, place[..., 0], place[..., 1]


def placed(picture: F64, centre: tuple[float, float, float], width: float, lean: tuple[float, float]) -> Card:
    """Place a photograph by its centre and width; `lean` is how much deeper its right and lower ends lie."""
    height = width * picture.shape[0] / picture.shape[1]
    right, down = np.array([width, 0.0, lean[0]]), np.array([0.0, height, lean[1]])
    return Card(picture, np.array(centre) - right / 2 - down / 2, right, down)


def cards(which: int = 0, blur: float = 0.0) -> tuple[Card, ...]:
    """Return one of three arrangements: a large leaning photograph behind two smaller ones.

    The large one is blurred by `blur`, the standard deviation as a share of its width: a plain wall from 0.04 on.
    """
    pictures = [np.asarray(load(), np.float64) / 255 for load in (skimage.data.coffee, skimage.data.astronaut)]
    pictures += [np.asarray(load(), np.float64) / 255 for load in (skimage.data.chelsea, skimage.data.rocket)]
    wall, one, two = [(0, 1, 2), (1, 2, 3), (3, 0, 2)][which]
    sigma = blur * pictures[wall].shape[1]
    behind = gaussian_filter(pictures[wall], (sigma, sigma, 0), mode="nearest")
    return (
        placed(behind, (0.0, 0.0, 2.6), 4.6, (0.5, -0.2)),
        placed(pictures[one], (-0.42, 0.1, 1.9), 0.75, (-0.15, 0.0)),
        placed(pictures[two], (0.45, -0.1, 1.5), 0.55, (0.1, 0.05)),
    )


def render(
    scene: Sequence[Card | Ball], world_to_camera: F64, intrinsics: F64, size: tuple[int, int]
) -> tuple[F32, F32]:
    """Return a view, [H, W, 3], and the depth along the optical axis at each pixel's centre, [H, W]."""
    height, width = size
    steps = (np.arange(_RAYS) + 0.5) / _RAYS
    y = (np.arange(height)[:, None] + steps).reshape(-1)
    x = (np.arange(width)[:, None] + steps).reshape(-1)
    grid = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], axis=-1)
    turn, shift = world_to_camera[:3, :3], world_to_camera[:3, 3]
    rays, origin = grid @ np.linalg.inv(intrinsics).T @ turn, -turn.T @ shift
    depth = np.full(rays.shape[:2], np.inf)
    image = np.zeros(rays.shape)
    for card in scene:
        # t is the depth, as rays advance by 1 along the axis.
        t, u, v = card.met(origin, rays)
        seen = (t > 0) & (t < depth) & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
        rows, columns = card.picture.shape[:2]
        places = np.stack([v[seen] * rows - 0.5, u[seen] * columns - 0.5])
        for channel in range(3):
            image[..., channel][seen] = map_coordinates(card.picture[..., channel], places, order=1, mode="nearest")
        depth[seen] = t[seen]
    image = image.reshape(height, _RAYS, width, _RAYS, 3).mean(axis=(1, 3))
    return image.astype(np.float32), depth[_RAYS // 2 :: _RAYS, _RAYS // 2 :: _RAYS].astype(np.float32)


def rail(places: F64, turn_rad: float = 0.01) -> F64:
    """Return poses, [len(places), 4, 4], along a rail to the right that bends and turns a little."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    for pose, place in zip(poses, places, strict=True):
        angle = turn_rad * place / max(1e-9, float(np.abs(places).max()))
        pose[:3, :3] = [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
        pose[:3, 3] = -pose[:3, :3] @ [place, 0.15 * place**2 / max(1e-9, float(np.abs(places).max())), 0.0]
    return poses


def expose(
    which: int,
    seed: int,
    *,
    size: tuple[int, int] = (192, 256),
    views: int = 8,
    travel: float = 0.12,
    noise: float = 0,
    blur: float = 0,
) -> tuple[Shot, F32, tuple[F32, F64]]:
    """Code views of a scene under random masks, a quarter open.

    Args:
        which: Of the arrangements.
        seed: Of masks and noise.
        size: Height and width, px.
        views: N.
        travel: Length of the path; the nearest card lies 1.5 away.
        noise: Standard deviation of white noise, in full scales of one view.
        blur: Of the large photograph (`cards`).

    Returns:
        The shot with its truth; the true depths [N, H, W]; the views beside its path (`beside_path`), [2, H, W, 3],
        with their poses, [2, 4, 4].
    """
    rng = np.random.default_rng(seed)
    intrinsics = pinhole(1.1 * size[1], size)
    places = np.linspace(-0.5, 0.5, views) * travel
    step = places[1] - places[0]
    # The rail reaches one step farther than the path.
    path = rail(np.append(places, places[-1] + step))[:views]
    poses = np.concatenate([path, beside_path(path)])
    scene = cards(which, blur)
    seen = [render(scene, pose, intrinsics, size) for pose in poses]
    images, depths = (np.stack([one[i] for one in seen]) for i in (0, 1))
    masks = (rng.random((views, *size)) < 0.25).astype(np.float32)
    measurement = (masks[..., None] * images[:views]).sum(axis=0) + rng.normal(0, noise, (*size, 3))
    shot = Shot(
        measurement.astype(np.float32),
        masks,
        np.ones(views, np.float32),
        intrinsics=intrinsics,
        truth=Truth(images[:views], poses[:views]),
        name=f"photographs on planes {which}",
    )
    return shot.check(), depths[:views], (images[views:], poses[views:])
