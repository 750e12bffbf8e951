"""The pseudo-views of the fine stage: poses beside the recovered cameras, and the weights of their pixels.

Here: the synthesised poses (paper, section III-D, eq. 8) and the support weight (eq. 9). Not here: the target images of
these views (`priors2d`), the loss and the loop (`fine.py`).
"""

import itertools
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy.spatial.transform import Rotation
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import Positive
from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class SupportSettings(Bounded):
    """The weight of a pixel of a pseudo-view, by the light that the Gaussians stop there (paper: IV-A).

    Args:
        threshold: Alpha at which the weight is half-way, τ_v.
        softness: Width of the transition, β_v.
        least: Weight of a pixel whose light nothing stops, w_min.
    """

    threshold: Annotated[float, Field(ge=0, le=1)] = 0.25
    softness: Positive = 0.08
    least: Annotated[float, Field(ge=0, le=1)] = 0.10


def synthesised_poses(world_to_camera: F64, between: int = 1) -> F64:
    """Make poses between the cameras of a path, and one step beyond either of its ends.

    Args:
        world_to_camera: The path, [N, 4, 4], in the order of exposure.
        between: How many between each two neighbours, equally spaced.

    Returns:
        [(N − 1) · between + 2, 4, 4]: those between, then the one before the first and the one after the last; none
        if there is only one camera.

    Raises:
        InputError: `between` is negative.
    """
    if between < 0:
        raise InputError(f"{between} poses between two cameras", allowed="0 or more")
    if len(world_to_camera) < 2:
        return np.empty((0, 4, 4))
    path = world_to_camera.astype(np.float64)
    shares = np.arange(1, between + 1) / (between + 1)
    inner = [interpolated(a, b, share) for a, b in itertools.pairwise(path) for share in shares]
    return np.stack([*inner, beyond(path[1], path[0]), beyond(path[-2], path[-1])])


def interpolated(a: F64, b: F64, share: float) -> F64:
    """Interpolate between two poses: rotations on SO(3), R = exp(α log(R_b R_aᵀ)) R_a, translations linearly.

    Args:
        a: World to camera, [4, 4].
        b: World to camera, [4, 4]; at 180° from `a` both directions are equally short, and one of them is taken.
        share: α; 0 gives `a`, 1 gives `b`.
    """
    pose = a.copy()
    pose[:3, :3] = (Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T) ** share).as_matrix() @ a[:3, :3]
    pose[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
    return pose


def beyond(before: F64, last: F64) -> F64:
    """Continue a path by one step: the transform from pose `before` to `last`, [4, 4], applied to `last` once more."""
    return last @ np.linalg.inv(before) @ last


def support_weights(alpha_then: Tensor, alpha_now: Tensor, settings: SupportSettings) -> Tensor:
    """Weigh pixels by the smaller of two alphas: when the target was made, and now.

    Args:
        alpha_then: [H, W].
        alpha_now: [H, W]; no gradient flows through the weight, or the fit could please the loss by fading away.
        settings: Of the transition.
    """
    support = torch.minimum(alpha_then, alpha_now.detach())
    rise = torch.sigmoid((support - settings.threshold) / settings.softness)
    return settings.least + (1 - settings.least) * rise
