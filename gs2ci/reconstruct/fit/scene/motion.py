"""Gaussians that move: their first motion, and the cost that keeps the others at rest.

A motion is a polynomial of time for each centre (`gs2ci.render.gaussians`). It starts with the velocity of the optical
flow that remains after the camera's motion is removed; the fit corrects it, since its rows are parameters like the
centres. Each row costs something in proportion to its length, so that only Gaussians that need a motion keep one: one
that moves by a pixel has to explain that much more of the measurement. In dark and uniform areas nothing moves.

Here: the settings, the start, and the share that moves. Not here: the step (`optimiser/gaussians.py`), when moving
scenes are fitted (`hypotheses.moving`), the flow (`geometry.flow`).
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.bounds import Bounded
from gs2ci.core.config import NotNegative
from gs2ci.core.lens import seen_by
from gs2ci.reconstruct.fit.scene.mask_moments import mask_times
from gs2ci.reconstruct.geometry.flow import velocity
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.gaussians import Gaussians

MOST_ROWS: Final = 4
# What moves less than this between the middle of the exposure and its end starts at rest, px: flow in decoded views is
# not more accurate.
_LEAST_FLOW_PX: Final = 0.3
# Below this length the cost is a parabola, so that its gradient is defined at zero.
_ROUND_PX: Final = 0.01


@dataclass(frozen=True)
class ObjectMotionSettings(Bounded):
    """How Gaussians may move.

    Args:
        rows: Degree of the polynomial: 1 is a velocity, 2 a velocity that changes evenly.
        cost: How much a Gaussian that moves by 1 px in half the exposure has to reduce the absolute error, in full
            scales, summed over the pixels.
    """

    rows: Annotated[int, Field(ge=1, le=MOST_ROWS)] = 2
    cost: NotNegative = 0.02

    def penalty(self, scene: Gaussians, px_per_length: float, pixels: int) -> Tensor | float:
        """Return the cost of a scene's motion, in the unit of the mean absolute error; 0 for a still scene.

        Args:
            scene: The Gaussians.
            px_per_length: The length of a scene unit in the picture, px.
            pixels: Number of pixels of the picture.
        """
        if scene.motion is None or not self.cost:
            return 0.0
        lengths = (scene.motion.square().sum(dim=2) + (_ROUND_PX / px_per_length) ** 2).sqrt()
        return (self.cost * px_per_length / pixels) * lengths.sum()


def set_moving(start: Gaussians, geometry: Geometry, views: F32, settings: ObjectMotionSettings) -> Gaussians:
    """Return first Gaussians with the motion that the views show of them.

    Args:
        start: The Gaussians, at their positions in the reference view.
        geometry: Poses and depth.
        views: Views from which the motion is estimated, [N, H, W, C].
        settings: How many rows there are; all but the first start at zero.
    """
    times = mask_times(len(views)).double().numpy()
    seen = velocity(views, geometry, times)
    seen[np.linalg.norm(seen, axis=2) < _LEAST_FLOW_PX] = 0
    pose = geometry.world_to_camera[geometry.reference]
    inside, depth, at = seen_by(start.means.double().numpy(), pose, geometry.intrinsics, seen.shape[:2])
    column, row = np.where(inside[:, None], at, 0).astype(int).T
    rates = np.where(inside[:, None], seen[row, column], 0) / geometry.intrinsics.diagonal()[:2] * depth[:, None]
    motion = torch.zeros(len(start), settings.rows, 3)
    motion[:, 0] = torch.from_numpy(np.concatenate([rates, np.zeros((len(rates), 1))], axis=1) @ pose[:3, :3])
    # A scene's positions are those at the middle of the exposure, where its motion is zero.
    means = start.means - motion[:, 0] * float(times[geometry.reference])
    return replace(start, means=means, motion=motion)


def of_degree(scene: Gaussians, number: int) -> Gaussians:
    """Return Gaussians with all rows of their motion for every second fit, and with the first row for the others.

    Fits whose errors differ average better: a velocity has too little freedom, a changing velocity too much.
    """
    return scene if scene.motion is None or number % 2 else replace(scene, motion=scene.motion[:, :1])


def moving_share(scene: Gaussians) -> float:
    """Return the share of a scene's opacity that moves."""
    if scene.motion is None or not len(scene):
        return 0.0
    opacity = torch.sigmoid(scene.opacity_logits.detach())
    moves = scene.motion.detach().abs().amax(dim=(1, 2)) > 0
    return float((opacity * moves).sum() / opacity.sum())
