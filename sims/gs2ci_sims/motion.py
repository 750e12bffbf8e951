"""How far the image moves while the camera does, from geometry alone: nothing is rendered."""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import in_world
from gs2ci.core.lens import rays_of
from gs2ci_sims.path import CameraPath, highest_hz
from gs2ci_sims.scene import Scene

# Steps in which an interval is followed, and at least so many per period of what shakes the camera, up to a bound
# beyond which only the amplitude counts.
STEPS_PER_INTERVAL: Final = 8
STEPS_PER_PERIOD: Final = 8
STEPS_MAX: Final = 4096
PLACES_MAX: Final = 256


def image_motion_px(scene: Scene, path: CameraPath, intervals_s: F64) -> F64:
    """Find how far the image moves, at most over the frame, within each interval, [N] pixels for [N, 2] seconds.

    A camera that turns back within an interval has moved all the same.
    """
    track = _tracks_within(scene, path, intervals_s, STEPS_MAX)
    return np.linalg.norm(np.diff(track, axis=0), axis=-1).sum(axis=0).max(axis=1)


def image_travel_px(scene: Scene, path: CameraPath, times_s: F64) -> F64:
    """Find how far the image has moved, at most over the frame, since the first of the times, [T] pixels."""
    track = tracks_px(scene, path, times_s)
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
    away = _tracks_within(scene, path, intervals_s, PLACES_MAX) - tracks_px(scene, seen_along, seen_s)
    return np.linalg.norm(away, axis=-1).max(axis=(0, 2))


def _tracks_within(scene: Scene, path: CameraPath, intervals_s: F64, most: int) -> F64:
    """Follow the points of `tracks_px` through intervals [N, 2], in at most so many steps, [T, N, 10, 2] pixels."""
    longest = float(np.diff(intervals_s, axis=1).max())
    steps = int(np.clip(STEPS_PER_PERIOD * highest_hz(path) * longest, STEPS_PER_INTERVAL, most))
    times = np.linspace(intervals_s[:, 0], intervals_s[:, 1], steps + 1)
    return tracks_px(scene, path, times.ravel()).reshape(steps + 1, len(intervals_s), -1, 2)


def tracks_px(scene: Scene, path: CameraPath, times_s: F64) -> F64:
    """Follow the corners and the middle of the frame at the nearest and the farthest depth, [T, 10, 2] pixels."""
    height, width = scene.size
    focal = np.array([scene.intrinsics[0, 0], scene.intrinsics[1, 1]])
    pixels = np.array([[0, 0], [width, 0], [0, height], [width, height], [width / 2, height / 2]], dtype=float)
    rays = rays_of(pixels, scene.intrinsics)
    points = in_world(np.concatenate([depth * rays for depth in scene.depth_range()]), scene.world_to_camera)
    poses = path.world_to_camera(times_s)
    seen = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    # A point beside or behind the camera counts as one at a tenth of the median depth: it is not in the image.
    depth = np.maximum(seen[..., 2:], 0.1 * scene.median_depth)
    return seen[..., :2] / depth * focal
