"""How far the image moves while the camera does, from geometry alone: nothing is rendered. For previews and planner."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_sims.moments import gauss_nodes, gauss_weights, lagrange
from gs2ci_sims.path import CameraPath, highest_hz
from gs2ci_sims.scenes.base import Scene

F64 = NDArray[np.float64]

# Steps in which an interval is followed, and at least so many per period of what shakes the camera, up to a bound
# beyond which only the amplitude counts.
STEPS_PER_INTERVAL: Final = 8
STEPS_PER_PERIOD: Final = 8
STEPS_MAX: Final = 4096


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


def sampling_error_px(scene: Scene, path: CameraPath, edges_s: F64, nodes: int) -> tuple[float, float]:
    """Find by how much Gauss-Legendre nodes misplace the image in panels of time, at most over the frame, in pixels.

    Args:
        scene: Whose near and far points are followed.
        path: Where the camera is at any time.
        edges_s: Ends of the panels, [P + 1].
        nodes: Per panel.

    Returns:
        The error of the mean place over a panel by quadrature, and the rms error of the place by interpolation. Both
        are 0 for an image that moves evenly and two nodes; a camera that swings within a panel makes them grow.
    """
    length = float(np.diff(edges_s).max())
    fine = int(np.clip(STEPS_PER_PERIOD * highest_hz(path) * length, 2 * STEPS_PER_INTERVAL, STEPS_MAX))
    places = (np.arange(fine) + 0.5) / fine
    points = gauss_nodes(nodes)
    times = edges_s[:-1, None] + np.diff(edges_s)[:, None] * np.concatenate([places, points])
    track = _tracks(scene, path, times.ravel()).reshape(len(edges_s) - 1, fine + nodes, -1, 2)
    swept, sampled = track[:, :fine], track[:, fine:]
    mean = swept.mean(axis=1) - np.tensordot(sampled, gauss_weights(nodes), axes=(1, 0))
    between = swept - np.einsum("tn,pnkc->ptkc", lagrange(points, places), sampled)
    deviation = np.sqrt(np.square(between).sum(axis=-1).mean(axis=1))
    return float(np.linalg.norm(mean, axis=-1).max()), float(deviation.max())


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
