"""A procedural scene of textured rectangles and boxes, drawn from a generator: for tests and experiments.

Here: the drawing of the scene and its exact depth. Not here: how rectangles become Gaussians (`surfels`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.scenes.base import Scene, camera_looking_ahead, gaussians_from_surfels
from gs2ci_sims.scenes.surfels import Surfels, from_tangents, join

F64 = NDArray[np.float64]

FIELD_OF_VIEW_DEG: Final = 50.0
# The backdrop extends this much past the frame, for the camera to move and turn into.
BACKDROP_OVERSIZE: Final = 1.5
# Distance between samples in pixels of the suggested camera: finer than a pixel, so that textures reach its limit.
SPACING_PX: Final = 0.6
# How far samples lie off their rectangle, along their rays from the suggested camera, as a share of their distance.
DEPTH_SCATTER: Final = 2e-3


@dataclass(frozen=True)
class Rectangle:
    """A textured rectangle: centre and half edges (vectors at right angles) in scene units, each [3]."""

    centre: F64
    half_u: F64
    half_v: F64


def planes(
    rng: np.random.Generator,
    size: tuple[int, int] = (96, 128),
    *,
    depths: tuple[float, ...] = (2.0, 2.7, 3.5),
    backdrop: float = 5.0,
    boxes: int = 1,
) -> Scene:
    """Draw tilted rectangles at the given depths before a backdrop, and boxes standing among them.

    Args:
        rng: Every position, tilt and texture comes from it.
        size: Height and width of the suggested camera's image, in pixels.
        depths: Depth of each rectangle's centre, in scene units.
        backdrop: Depth of the backdrop, which fills the frame.
        boxes: How many boxes (each shows up to five faces).

    Raises:
        InputError: A depth is not positive or lies behind the backdrop.
    """
    if min((*depths, backdrop)) <= 0 or max(depths, default=0) >= backdrop:
        raise InputError(
            f"rectangles at depths {depths} before a backdrop at {backdrop}",
            allowed="positive depths, each in front of the backdrop",
        )
    intrinsics = camera_looking_ahead(size, FIELD_OF_VIEW_DEG)
    half = 0.5 * np.array([size[1], size[0]]) / intrinsics[0, 0]  # half the frame at depth 1
    rectangles = [_backdrop(half, backdrop)]
    rectangles += [_tilted(rng, half, depth) for depth in depths]
    for _ in range(boxes):
        rectangles += _box(rng, half, float(rng.uniform(0.4, 0.7)) * backdrop)
    surfels = [_surfels(rng, rectangle, intrinsics[0, 0]) for rectangle in rectangles]
    return Scene(
        "planes", gaussians_from_surfels(join(surfels)), intrinsics, size, _depth(rectangles, intrinsics, size)
    )


def texture(rng: np.random.Generator, shape: tuple[int, int], slope: float) -> F64:
    """Draw coloured noise whose amplitude falls as frequency^-slope, [H, W, 3] in [0, 1].

    Slope 0 is white noise, 1 the statistics of natural images (Field 1987), 2 soft clouds. Every frequency that
    the sampling can hold is present.
    """
    height, width = shape
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :])
    frequency[0, 0] = 1.0
    spectrum = np.fft.rfft2(rng.standard_normal((3, height, width))) * frequency**-slope
    spectrum[:, 0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, s=shape)
    noise /= np.maximum(noise.std(axis=(1, 2), keepdims=True), 1e-12)
    mean = rng.uniform(0.25, 0.75, (3, 1, 1))
    return np.moveaxis(np.clip(mean + 0.18 * noise, 0.0, 1.0), 0, -1)


def _backdrop(half: F64, depth: float) -> Rectangle:
    wide, high = BACKDROP_OVERSIZE * depth * half
    return Rectangle(np.array([0, 0, depth]), np.array([wide, 0, 0]), np.array([0, high, 0]))


def _tilted(rng: np.random.Generator, half: F64, depth: float) -> Rectangle:
    centre = np.array([*(rng.uniform(-0.6, 0.6, 2) * half * depth), depth])
    axes = _rotation(rng.uniform(-0.5, 0.5, 3))
    wide, high = rng.uniform(0.25, 0.45, 2) * half.min() * depth
    return Rectangle(centre, wide * axes[:, 0], high * axes[:, 1])


def _box(rng: np.random.Generator, half: F64, depth: float) -> list[Rectangle]:
    """Five faces; the one that always looks away is left out."""
    centre = np.array([*(rng.uniform(-0.5, 0.5, 2) * half * depth), depth])
    axes = _rotation(rng.uniform(-0.6, 0.6, 3)) * (rng.uniform(0.15, 0.25, 3) * half.min() * depth)
    x, y, z = axes.T
    return [
        Rectangle(centre - z, x, y),
        Rectangle(centre - x, y, z),
        Rectangle(centre + x, y, z),
        Rectangle(centre - y, x, z),
        Rectangle(centre + y, x, z),
    ]


def _rotation(angles: F64) -> F64:
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def _surfels(rng: np.random.Generator, rectangle: Rectangle, focal: float) -> Surfels:
    spacing = SPACING_PX * rectangle.centre[2] / focal
    columns, rows = (
        max(2, int(np.ceil(2 * np.linalg.norm(half) / spacing))) for half in (rectangle.half_u, rectangle.half_v)
    )
    radiance = texture(rng, (rows, columns), float(rng.uniform(0.5, 1.8))).reshape(-1, 3)
    u = (np.arange(columns) + 0.5) / columns * 2 - 1
    v = (np.arange(rows) + 0.5) / rows * 2 - 1
    grid_v, grid_u = (axis.reshape(-1, 1) for axis in np.meshgrid(v, u, indexing="ij"))
    points = rectangle.centre + grid_u * rectangle.half_u + grid_v * rectangle.half_v
    along_u = np.broadcast_to(2 * rectangle.half_u / columns, points.shape)
    along_v = np.broadcast_to(2 * rectangle.half_v / rows, points.shape)
    # Splats are drawn in the order of their depths. Those of an exact plane that faces the camera have all the same,
    # and a turn by a millionth would reorder them and change the picture by percents; so none lies exactly in it.
    aside = np.random.default_rng(len(points)).uniform(-DEPTH_SCATTER, DEPTH_SCATTER, (len(points), 1))
    return from_tangents(points * (1 + aside), along_u, along_v, radiance)


def _depth(rectangles: list[Rectangle], intrinsics: F64, size: tuple[int, int]) -> F64:
    """Intersect every pixel's ray with every rectangle and keep the nearest, [H, W]."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    rays = np.stack([(x - intrinsics[0, 2]) / intrinsics[0, 0], (y - intrinsics[1, 2]) / intrinsics[1, 1]], -1)
    rays = np.concatenate([rays, np.ones((*size, 1))], -1)
    nearest = np.full(size, np.inf)
    for rectangle in rectangles:
        normal = np.cross(rectangle.half_u, rectangle.half_v)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays along the plane meet it nowhere
            depth = (normal @ rectangle.centre) / (rays @ normal)
            offset = depth[..., None] * rays - rectangle.centre
            inside = depth > 0
            for half in (rectangle.half_u, rectangle.half_v):
                inside &= np.abs(offset @ half) <= half @ half
        nearest = np.where(inside, np.minimum(nearest, depth), nearest)
    return np.where(np.isfinite(nearest), nearest, np.nan)
