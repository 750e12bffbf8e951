"""Quality of a recovered scene from new poses, compared with true views that the measurement does not contain.

Here: the pose of such a view in the recovered world, and its score. Not here: alignment (`gs2ci.evaluate.trajectory`),
image metrics (`gs2ci.evaluate.metrics`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import rigid
from gs2ci.core.errors import InputError
from gs2ci.core.records import check_rigid
from gs2ci.evaluate.metrics import image_scores
from gs2ci.evaluate.trajectory import Alignment
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

# Of views with full scale 1: noise and overshoot reach a little beyond 0 and 1. What reaches further has another scale.
_VALUE_RANGE: Final = (-0.5, 1.5)


@dataclass(frozen=True)
class NovelViews:
    """True views from poses that the measurement does not contain.

    Args:
        views: As a pinhole camera sees them, whatever the lens of the measurement: [M, H, W, C] float32, full scale 1.
        world_to_camera: Their poses in the world of the true camera path, [M, 4, 4].
    """

    views: F32
    world_to_camera: F64


def read_novel_views(path: Path) -> NovelViews:
    """Read views and poses from an .npz file with `views` ([M, H, W, C]) and `world_to_camera`.

    Views of uint8 and uint16 are divided by their largest value; others have full scale 1.

    Raises:
        InputError: No such file, an array is missing, the two do not fit together, values are far beyond the full
            scale, or poses are not rigid.
    """
    try:
        # Opened here, because numpy does not close a truncated file.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            views, poses = arrays["views"], arrays["world_to_camera"].astype(np.float64)
            full = np.iinfo(views.dtype).max if views.dtype in (np.uint8, np.uint16) else 1
            views = (views / np.float32(full)).astype(np.float32)
    except Exception as error:  # damage raises almost any exception
        raise InputError(
            f"{path} holds no novel views: {error}", allowed="an .npz file with views and world_to_camera"
        ) from error
    fits = views.ndim == 4 and len(views) and views.shape[3] in (1, 3) and poses.shape == (len(views), 4, 4)
    if not fits or not (np.isfinite(views).all() and np.isfinite(poses).all()):
        raise InputError(
            f"{path} holds views {list(views.shape)} and poses {list(poses.shape)}",
            allowed="finite [M, H, W, C] with C = 1 or 3, and [M, 4, 4]",
        )
    check_full_scale(path, views)
    check_rigid(f"{path}: world_to_camera", poses)
    return NovelViews(views, poses)


def check_full_scale(path: Path, views: F32) -> None:
    """Check that the true views of a file have full scale 1.

    Raises:
        InputError: They reach farther than noise and overshoot do.
    """
    least, most = _VALUE_RANGE
    if views.min() < least or views.max() > most:
        raise InputError(
            f"{path} holds views from {views.min():.4g} to {views.max():.4g}",
            allowed="full scale 1, or uint8 or uint16 with their own full scale",
            remedy="divide them by the value of white",
        )


def poses_in_estimate(alignment: Alignment, world_to_camera: F64) -> F64:
    """Express poses of the true world, [M, 4, 4], in the recovered one, at its scale.

    With x_true = s R x + t a camera [A | b] of the true world maps x to s A R x + (A t + b); divided by s, this is seen
    at the same pixels.
    """
    turn = world_to_camera[:, :3, :3]
    shift = (turn @ alignment.translation + world_to_camera[:, :3, 3]) / alignment.scale
    return rigid(turn @ alignment.rotation, shift)


def score_novel_views(scene: Gaussians, alignment: Alignment, intrinsics: F64, novel: NovelViews) -> dict[str, Any]:
    """Render the scene from the poses of the novel views, and score it: PSNR in dB and SSIM, per view and mean.

    Args:
        scene: The recovered Gaussians.
        alignment: Alignment of the recovered camera path with the true one.
        intrinsics: Camera matrix of the novel views, which are a pinhole's, in px, [3, 3].
        novel: The true views.
    """
    poses = torch.from_numpy(poses_in_estimate(alignment, novel.world_to_camera)).float()
    height, width, channels = novel.views.shape[1:]
    with torch.no_grad():
        images, _ = load_backend().views(scene, poses, torch.from_numpy(intrinsics).float(), (height, width))
    shown = images.numpy() if channels == 3 else images.mean(dim=3, keepdim=True).numpy()
    return image_scores(shown, novel.views)
