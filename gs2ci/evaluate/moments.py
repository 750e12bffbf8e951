"""More pictures than there were masks: a scene at moments spread over the exposure, from interpolated cameras.

Here: the times, the interpolated poses, the pictures, and a scene file of each moment if things move. Not here: fitting
a moving scene (`gs2ci.reconstruct.hypotheses.moving`), the views under the masks (`run_folder`).
"""

from numbers import Integral
from typing import Any, Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import camera_centres, rigid
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.reconstruct.choices import MOST_MOMENTS
from gs2ci.reconstruct.fit.scene.mask_moments import mask_times
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

MOMENTS_NAME: Final = "moments"
# Number of moments rendered together: more need more memory, fewer save no time.
_AT_ONCE: Final = 8


def moments(count: int) -> F64:
    """Return `count` times, equally spaced from the first mask's, −1, to the last's, 1.

    Raises:
        InputError: Fewer than two, or too many, or no whole number.
    """
    given: Any = count  # in Python it may be of any kind
    if not isinstance(given, Integral) or not 2 <= count <= MOST_MOMENTS:
        raise InputError(f"{count} moments", allowed=f"a whole number from 2 to {MOST_MOMENTS}")
    return np.linspace(-1.0, 1.0, count)


def poses_at(world_to_camera: F64, times: F64) -> F64:
    """Interpolate the camera's poses, [K, 4, 4]: uniform rotation and straight motion from each pose to the next.

    Args:
        world_to_camera: Pose under each mask, [N, 4, 4].
        times: Requested times, from −1 to 1, [K].
    """
    if len(world_to_camera) == 1:
        return np.repeat(world_to_camera, len(times), axis=0)
    known = mask_times(len(world_to_camera)).double().numpy()
    times = np.clip(times, known[0], known[-1])
    rotations = Slerp(known, Rotation.from_matrix(world_to_camera[:, :3, :3]))(times).as_matrix()
    centres = camera_centres(world_to_camera)
    between = np.stack([np.interp(times, known, centres[:, axis]) for axis in range(3)], axis=1)
    return rigid(rotations, -np.einsum("kij,kj->ki", rotations, between))


def render_moments(shot: Shot, result: RunResult, scene: Gaussians, times: F64) -> F32:
    """Render the scene at times between those of the masks, [K, H, W, C] float32, not clamped.

    Args:
        shot: The reconstructed shot, for its size and lens.
        result: Poses and camera matrix.
        scene: The Gaussians.
        times: From −1 to 1, [K].
    """
    seen = result.registered or shot
    renderer = ShotRenderer(seen, result.intrinsics, load_backend(), Lens.of(seen))
    poses = torch.from_numpy(poses_at(result.world_to_camera, times)).float()
    when = torch.from_numpy(times).float()
    parts = [slice(begin, begin + _AT_ONCE) for begin in range(0, len(times), _AT_ONCE)]
    return np.concatenate([renderer.views(scene.detach(), poses[part], when[part]) for part in parts])
