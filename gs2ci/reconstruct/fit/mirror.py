"""A fitted scene turned inside out: what was near is far, and the cameras go the other way.

The reversal of `geometry/reversal.py`, for Gaussians: every centre moves along its ray of the reference view to the
inverse depth c - rho, and its covariance goes through the derivative of that map, so that a slanted surface becomes
the surface slanted the other way. The reference view hardly changes; the others change in what hides what, and in
perspective. Here: the reversal in float64. Not here: fits of what comes of it (`reconstruct.order_fits`).
"""

from typing import Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.geometry.reversal import FARTHEST, reversed_poses
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians, rotation_matrices

# Standard deviations are no smaller than this, in scene units, whose median depth is 1: a disc seen from its side.
_THINNEST: Final = 1e-6


def inside_out(scene: Gaussians, world_to_camera: F64, reference: int, c: float) -> tuple[Gaussians, F64]:
    """Turn a scene and its path inside out.

    Args:
        scene: Gaussians that rest.
        world_to_camera: Poses, [N, 4, 4].
        reference: The view whose rays the centres stay on, and whose pose stays.
        c: Inverse depths rho of that view become c - rho, where that is not too far; > 0.

    Returns:
        The Gaussians, float32, and poses, [N, 4, 4].
    """
    own = world_to_camera[reference]
    turn, shift = torch.from_numpy(own[:3, :3]), torch.from_numpy(own[:3, 3])
    exact = scene.detach().map(lambda tensor: tensor.double())
    points = exact.means @ turn.T + shift
    depth = points[:, 2].clamp(min=NEAR)
    least = FARTHEST * c / 2
    inverse = (c - 1 / depth).clamp(min=least)
    # A point grows with its distance along the ray by `growth`, whose derivative by depth is `slope`.
    growth = 1 / (inverse * depth)
    slope = torch.where(c - 1 / depth > least, -c / (c * depth - 1) ** 2, -1 / (least * depth**2))
    ahead = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    derivative = growth[:, None, None] * torch.eye(3, dtype=torch.float64)
    derivative = derivative + slope[:, None, None] * points[:, :, None] * ahead
    axes = turn.T @ derivative @ turn @ (rotation_matrices(exact.quaternions) * exact.log_scales.exp()[:, None, :])
    turned, sizes, _ = torch.linalg.svd(axes)
    turned[:, :, 2] *= torch.linalg.det(turned).sign()[:, None]
    reversed_scene = Gaussians(
        means=((growth[:, None] * points - shift) @ turn).float(),
        log_scales=sizes.clamp(min=_THINNEST).log().float(),
        quaternions=torch.from_numpy(Rotation.from_matrix(turned.numpy()).as_quat(scalar_first=True)).float(),
        opacity_logits=scene.opacity_logits.detach().clone(),
        colours=scene.colours.detach().clone(),
    )
    return reversed_scene, reversed_poses(world_to_camera @ np.linalg.inv(own), c) @ own
