"""Textured rectangles and boxes: their discs, and their intersections with a camera's rays.

Here: geometry and texture, from a generator. Not here: the scenes made of them (the other modules of this folder), the
conversion of points and tangents to Gaussians (`surfels`).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.lens import pixel_centres, rays_of
from gs2ci_sims.scenes.surfels import Surfels, from_tangents

# Distance between samples in pixels of the suggested camera: finer than a pixel, so that textures reach its limit.
SPACING_PX: Final = 0.6
# Random offset of samples from their rectangle, along their rays from the suggested camera, over their distance.
DEPTH_SCATTER: Final = 2e-3
# Each strip of a receding surface ends this much deeper than it begins.
STRIP_RATIO: Final = 1.2
# Discs of a receding surface are at most this much longer than broad: longer ones would blur the texture across.
FORESHORTENING_MAX: Final = 4.0
# Direction towards the light, for shading: above, to the left and behind the camera.
TOWARDS_LIGHT: Final = np.array([-0.4, -0.75, -0.55])


@dataclass(frozen=True)
class Rectangle:
    """A textured rectangle: centre and half edges (vectors at right angles) in scene units, each [3]."""

    centre: F64
    half_u: F64
    half_v: F64


def texture(rng: Rng, shape: tuple[int, int], slope: float) -> F64:
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


def box(centre: F64, half_edges: F64) -> list[Rectangle]:
    """List five faces of a box; the one that always faces away from a camera at the origin is left out.

    Args:
        centre: [3].
        half_edges: Half the edges as columns, at right angles, [3, 3]; the last one points away from the camera.
    """
    x, y, z = half_edges.T
    return [
        Rectangle(centre - z, x, y),
        Rectangle(centre - x, y, z),
        Rectangle(centre + x, y, z),
        Rectangle(centre - y, x, z),
        Rectangle(centre + y, x, z),
    ]


def rotation(angles: F64) -> F64:
    """Return the rotation matrix for angles in radians [3] about x, then y, then z."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def textured(rng: Rng, rectangle: Rectangle, focal: float) -> Surfels:
    """Cover a rectangle with discs of a random texture, as fine as a camera of this focal length (px) resolves."""
    columns, rows = samples(rectangle, SPACING_PX * rectangle.centre[2] / focal)
    return coloured(rectangle, texture(rng, (rows, columns), float(rng.uniform(0.5, 1.8))))


def samples(rectangle: Rectangle, spacing_u: float, spacing_v: float | None = None) -> tuple[int, int]:
    """Count the discs along u and v for these spacings in scene units (one spacing holds for both), 2 or more."""
    halves = ((rectangle.half_u, spacing_u), (rectangle.half_v, spacing_v or spacing_u))
    columns, rows = (max(2, int(np.ceil(2 * np.linalg.norm(half) / spacing))) for half, spacing in halves)
    return columns, rows


def shade(rectangle: Rectangle) -> float:
    """Return the shading of a face, 0.35 to 1: Lambert's cosine for `TOWARDS_LIGHT`, and ambient light.

    It is that of the side that faces the camera at the origin.
    """
    normal = np.cross(rectangle.half_u, rectangle.half_v)
    normal = -normal * np.sign(normal @ rectangle.centre) / np.linalg.norm(normal)
    return float(0.35 + 0.65 * max(0.0, normal @ TOWARDS_LIGHT / np.linalg.norm(TOWARDS_LIGHT)))


def coloured(rectangle: Rectangle, radiance: F64) -> Surfels:
    """Cover a rectangle with one disc per sample of its radiance, [rows along v, columns along u, 3]."""
    rows, columns = radiance.shape[:2]
    u = (np.arange(columns) + 0.5) / columns * 2 - 1
    v = (np.arange(rows) + 0.5) / rows * 2 - 1
    grid_v, grid_u = (axis.reshape(-1, 1) for axis in np.meshgrid(v, u, indexing="ij"))
    points = rectangle.centre + grid_u * rectangle.half_u
    points += grid_v * rectangle.half_v
    along_u = np.broadcast_to(2 * rectangle.half_u / columns, points.shape)
    along_v = np.broadcast_to(2 * rectangle.half_v / rows, points.shape)
    # Splats are drawn in the order of their depths. On an exact plane that faces the camera all depths are the same,
    # and a rotation by a millionth would reorder the splats and change the picture by percents; so they are offset.
    aside = np.random.default_rng(len(points)).uniform(-DEPTH_SCATTER, DEPTH_SCATTER, (len(points), 1))
    points *= 1 + aside
    return from_tangents(points, along_u, along_v, radiance.reshape(-1, 3))


def grain(rng: Rng, shape: tuple[int, int], slope: float) -> F64:
    """Draw the grain of a paint, [H, W, 3] of mean 0 and an amplitude of about a quarter, mostly in brightness."""
    noise = texture(rng, shape, slope)
    noise -= noise.mean(axis=(0, 1))
    grey = noise.mean(axis=2, keepdims=True)
    return 2.0 * grey + 0.6 * (noise - grey)


def receding(centre_xy: F64, half_xy: F64, near: float, far: float) -> list[Rectangle]:
    """Cut a floor, ceiling or wall parallel to the line of sight into strips, each a fifth deeper than the last.

    The size of a strip's discs depends on its distance, so that a long surface is neither coarse near by nor dense far
    away.

    Args:
        centre_xy: Position of the surface across the line of sight, [2].
        half_xy: Half its breadth across, [2].
        near: Depth of its begin.
        far: Depth of its end, beyond `near`.
    """
    count = int(np.ceil(np.log(far / near) / np.log(STRIP_RATIO)))
    edges = np.geomspace(near, far, count + 1)
    return [
        Rectangle(np.array([*centre_xy, 0.5 * (a + b)]), np.array([*half_xy, 0.0]), np.array([0, 0, 0.5 * (b - a)]))
        for a, b in pairwise(edges)
    ]


def strip_samples(strip: Rectangle, focal: float) -> tuple[int, int]:
    """Count a receding strip's discs across and along: foreshortened, it needs fewer along the line of sight."""
    near = strip.centre[2] - strip.half_v[2]
    aside = float(np.linalg.norm(strip.centre[:2]))
    across = SPACING_PX * near / focal
    return samples(strip, across, across * float(np.clip(near / aside, 1.0, FORESHORTENING_MAX)))


def chequered(rng: Rng, strip: Rectangle, tile: float, colours: F64, focal: float) -> Surfels:
    """Cover a strip with tiles of two colours [2, 3] and a fine grain; tiles continue from strip to strip."""
    columns, rows = strip_samples(strip, focal)
    u = (np.arange(columns) + 0.5) / columns * 2 - 1
    v = (np.arange(rows) + 0.5) / rows * 2 - 1
    across = u * np.linalg.norm(strip.half_u)
    along = strip.centre[2] + v * strip.half_v[2]
    odd = (np.floor(across[None] / tile) + np.floor(along[:, None] / tile)).astype(int) % 2
    return coloured(strip, np.clip(colours[odd] * (1 + grain(rng, (rows, columns), 0.7)), 0.0, 1.0))


def depth_of(rectangles: list[Rectangle], intrinsics: F64, size: tuple[int, int]) -> F64:
    """Return the depth of the nearest rectangle on every pixel's ray, [H, W]; NaN for rays that miss all."""
    directions = rays_of(pixel_centres(size), intrinsics)
    nearest = np.full(size, np.inf)
    for rectangle in rectangles:
        window = _window(rectangle, intrinsics, size)
        seen = directions[window]
        normal = np.cross(rectangle.half_u, rectangle.half_v)
        with np.errstate(divide="ignore", invalid="ignore"):  # rays parallel to the plane do not meet it
            depth = (normal @ rectangle.centre) / (seen @ normal)
            offset = depth[..., None] * seen - rectangle.centre
            inside = depth > 0
            for half in (rectangle.half_u, rectangle.half_v):
                inside &= np.abs(offset @ half) <= half @ half
        nearest[window] = np.where(inside, np.minimum(nearest[window], depth), nearest[window])
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _window(rectangle: Rectangle, intrinsics: F64, size: tuple[int, int]) -> tuple[slice, slice]:
    """Find the pixels that a rectangle's corners enclose; all pixels if a corner is not in front of the camera."""
    signs = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    corners = (rectangle.centre + signs @ np.stack([rectangle.half_u, rectangle.half_v])) @ intrinsics.T
    if corners[:, 2].min() <= 1e-6:
        return slice(0, size[0]), slice(0, size[1])
    low, high = (edge(corners[:, :2] / corners[:, 2:], axis=0) for edge in (np.min, np.max))
    first = np.clip(np.floor(low), 0, [size[1], size[0]]).astype(int)
    last = np.clip(np.ceil(high), 0, [size[1], size[0]]).astype(int)
    return slice(first[1], last[1]), slice(first[0], last[0])
