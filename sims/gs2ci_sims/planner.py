"""How finely an effect must be sampled for a given scene and path. For whoever sets up an exposure."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_sims.path import CameraPath
from gs2ci_sims.scenes.base import Scene

F64 = NDArray[np.float64]

# Moments δ px apart pass a pattern of frequency f (cycles/px) by x / sin x more than the continuous sweep does,
# with x = π f δ: at half a pixel by 11 % at Nyquist (f = 1/2), where a sweep passes little; by 2.6 % at f = 1/4.
STEP_PX: Final = 0.5
MAX_SAMPLES: Final = 64


def image_motion_px(scene: Scene, path: CameraPath, intervals_s: F64) -> F64:
    """Find how far the image moves, at most over the frame, within each interval, [N] pixels for [N, 2] seconds.

    The corners and the middle of the frame, at the nearest and the farthest depth of the scene, are followed in
    quarters of each interval: a camera that turns back within it has moved all the same.
    """
    height, width = scene.size
    focal = np.array([scene.intrinsics[0, 0], scene.intrinsics[1, 1]])
    pixels = np.array([[0, 0], [width, 0], [0, height], [width, height], [width / 2, height / 2]], dtype=float)
    slopes = (pixels - scene.intrinsics[:2, 2]) / focal
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    points = np.concatenate([depth * rays for depth in scene.depth_range()])
    points = (points - scene.world_to_camera[:3, 3]) @ scene.world_to_camera[:3, :3]
    track = []
    for times in np.linspace(intervals_s[:, 0], intervals_s[:, 1], 5):
        poses = path.world_to_camera(times)
        seen = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        # A point beside or behind the camera counts as one at a tenth of the median depth: it is not in the image.
        depth = np.maximum(seen[..., 2:], 0.1 * scene.median_depth)
        track.append(seen[..., :2] / depth * focal)
    return np.asarray(np.linalg.norm(np.diff(track, axis=0), axis=-1).sum(axis=0).max(axis=1))


def motion_samples(scene: Scene, path: CameraPath, intervals_s: F64) -> int:
    """Choose how many moments stand for each interval: one per half pixel of the fastest interval, at most 64."""
    fastest = float(image_motion_px(scene, path, intervals_s).max())
    return int(np.clip(np.ceil(fastest / STEP_PX), 1, MAX_SAMPLES))
