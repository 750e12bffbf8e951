"""How far the image moves while the camera does, from geometry alone: nothing is rendered."""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.moments import gauss_nodes, gauss_weights, lagrange
from gs2ci_sims.path import CameraPath, highest_hz
from gs2ci_sims.scene import Scene

# Steps in which an interval is followed, and at least so many per period of what shakes the camera, up to a bound
# beyond which only the amplitude counts.
STEPS_PER_INTERVAL: Final = 8
STEPS_PER_PERIOD: Final = 8
STEPS_MAX: Final = 4096
PLACES_MAX: Final = 256
# Directions in which cosines run across the image, and how many pairs of point and direction are followed.
DIRECTIONS: Final = np.array([[1.0, 0.0, 0.5**0.5, 0.5**0.5], [0.0, 1.0, 0.5**0.5, -(0.5**0.5)]])
TRACKS_MAX: Final = 12
# Spacings of frequencies that differ by no more than this, cycles per pixel, are the same but for rounding.
SPACING_ROUNDING: Final = 1e-12


def image_motion_px(scene: Scene, path: CameraPath, intervals_s: F64) -> F64:
    """Find how far the image moves, at most over the frame, within each interval, [N] pixels for [N, 2] seconds.

    A camera that turns back within an interval has moved all the same.
    """
    longest = float(np.diff(intervals_s, axis=1).max())
    steps = int(np.clip(STEPS_PER_PERIOD * highest_hz(path) * longest, STEPS_PER_INTERVAL, STEPS_MAX))
    times = np.linspace(intervals_s[:, 0], intervals_s[:, 1], steps + 1)
    track = _tracks(scene, path, times.ravel()).reshape(steps + 1, len(intervals_s), -1, 2)
    return np.asarray(np.linalg.norm(np.diff(track, axis=0), axis=-1).sum(axis=0).max(axis=1))


def image_travel_px(scene: Scene, path: CameraPath, times_s: F64) -> F64:
    """Find how far the image has moved, at most over the frame, since the first of the times, [T] pixels."""
    track = _tracks(scene, path, times_s)
    steps = np.linalg.norm(np.diff(track, axis=0), axis=-1).max(axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def displacement_px(scene: Scene, path: CameraPath, seen_along: CameraPath, seen_s: F64, intervals_s: F64) -> F64:
    """Find how far the image is, at most over the frame and over each interval, from where it was seen, [N] pixels.

    Args:
        scene: Whose near and far points are followed.
        path: Where the camera is during the intervals.
        seen_along: Where it was when it saw.
        seen_s: When, [N].
        intervals_s: [N, 2].
    """
    longest = float(np.diff(intervals_s, axis=1).max())
    steps = int(np.clip(STEPS_PER_PERIOD * highest_hz(path) * longest, STEPS_PER_INTERVAL, PLACES_MAX))
    times = np.linspace(intervals_s[:, 0], intervals_s[:, 1], steps + 1)
    there = _tracks(scene, path, times.ravel()).reshape(steps + 1, len(intervals_s), -1, 2)
    away = there - _tracks(scene, seen_along, seen_s)
    return np.asarray(np.linalg.norm(away, axis=-1).max(axis=(0, 2)))


def net_motion_px(scene: Scene, path: CameraPath, edges_s: F64) -> float:
    """Find how far the image is moved from one end of a panel of time to the other, rms over the panels, pixels."""
    steps = np.linalg.norm(np.diff(_tracks(scene, path, edges_s), axis=0), axis=-1).max(axis=1)
    return float(np.sqrt(np.square(steps).mean()))


def sweep_errors(
    scene: Scene, path: CameraPath, edges_s: F64, nodes: int, frequencies: F64, object_px_per_s: float = 0.0
) -> tuple[F64, F64]:
    """Find what sampling a moving image at Gauss-Legendre nodes gets wrong, for cosines of some frequencies.

    The phases of the cosines follow the points of `_tracks` through the panels, however uneven their motion.

    Args:
        scene: Whose near and far points are followed.
        path: Where the camera is at any time.
        edges_s: Ends of the panels, [P + 1].
        nodes: Per panel.
        frequencies: Cycles per pixel, [F].
        object_px_per_s: How fast objects move by themselves, either way.

    Returns:
        As shares of the amplitude, rms over the panels, of the worst point and direction, [F] each: the error of the
        integral over a panel by quadrature, and of the wave itself by interpolation (rms over time).
    """
    places = _places(path, float(np.diff(edges_s).max()))
    points = gauss_nodes(nodes)
    times = edges_s[:-1, None] + np.diff(edges_s)[:, None] * np.concatenate([places, points])
    track = _tracks(scene, path, times.ravel()).reshape(*times.shape, -1, 2) @ DIRECTIONS
    if object_px_per_s:
        own = object_px_per_s * (times - times.mean(axis=1, keepdims=True))[..., None, None]
        track = np.concatenate([track, track + own, track - own], axis=2)
    track = track.reshape(*times.shape, -1)
    # Only the longest ways matter; phases are counted from the middle of each.
    longest = np.argsort(np.ptp(track, axis=1).max(axis=0))[-TRACKS_MAX:]
    track = track[..., longest] - track[..., longest].mean(axis=1, keepdims=True)
    basis, weights = lagrange(points, places).astype(np.complex128), gauss_weights(nodes)
    quadrature, interpolation = np.zeros(len(frequencies)), np.zeros(len(frequencies))
    # Where frequencies are evenly spaced, each wave is the one before times the same: an exponential for all of them.
    wave, before, apart = np.ones(track.shape, dtype=np.complex128), 0.0, np.nan
    for number, frequency in enumerate(frequencies):
        if not abs(frequency - before - apart) < SPACING_ROUNDING:
            apart = frequency - before
            turn = np.exp(2j * np.pi * apart * track)
        wave, before = wave * turn, frequency
        swept, sampled = wave[:, : len(places)], wave[:, len(places) :]
        missed = np.abs(swept.mean(axis=1) - np.tensordot(sampled, weights, axes=(1, 0)))
        between = np.abs(swept - basis @ sampled)
        quadrature[number] = np.sqrt(np.square(missed).mean(axis=0).max(initial=0.0))
        interpolation[number] = np.sqrt(np.square(between).mean(axis=(0, 1)).max(initial=0.0))
    return quadrature, interpolation


def _places(path: CameraPath, longest_s: float) -> F64:
    """Return the middles of equal parts of [0, 1] that follow a path through a panel."""
    count = int(np.clip(STEPS_PER_PERIOD * highest_hz(path) * longest_s, 3 * STEPS_PER_INTERVAL, PLACES_MAX))
    return np.asarray((np.arange(count) + 0.5) / count)


def _tracks(scene: Scene, path: CameraPath, times_s: F64) -> F64:
    """Follow the corners and the middle of the frame at the nearest and the farthest depth, [T, 10, 2] pixels."""
    height, width = scene.size
    focal = np.array([scene.intrinsics[0, 0], scene.intrinsics[1, 1]])
    pixels = np.array([[0, 0], [width, 0], [0, height], [width, height], [width / 2, height / 2]], dtype=float)
    slopes = (pixels - scene.intrinsics[:2, 2]) / focal
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    points = np.concatenate([depth * rays for depth in scene.depth_range()])
    points = (points - scene.world_to_camera[:3, 3]) @ scene.world_to_camera[:3, :3]
    poses = path.world_to_camera(times_s)
    seen = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    # A point beside or behind the camera counts as one at a tenth of the median depth: it is not in the image.
    depth = np.maximum(seen[..., 2:], 0.1 * scene.median_depth)
    return np.asarray(seen[..., :2] / depth * focal)
