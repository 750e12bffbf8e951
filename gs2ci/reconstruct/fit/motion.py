"""Gaussians that move, and which of them: where their motion begins, and what takes it from those that need none.

A motion is a polynomial of time for each centre (`gs2ci.render.gaussians`). It begins at the velocity that optical flow
shows beyond the camera's, and whatever the flow missed, the fit may give: its rows are parameters as the centres are.
Each row costs something by its length, so that it stays with those that need it: what moves by a pixel has to explain
so much more of the measurement for it. Where nothing is to be seen, in the dark and in even surfaces, nothing moves.

Here: the settings, the beginning, and the figures of what moves. Not here: the step (`optimiser.py`), when a scene is
let move (`gs2ci.reconstruct.moving`), the flow (`geometry.flow`).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.mask_moments import mask_times
from gs2ci.reconstruct.geometry.flow import velocity
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.gaussians import Gaussians

MOST_ROWS: Final = 4
# What moves less than this between the middle of the exposure and its end begins at rest, px: flow in decoded views is
# no better.
_LEAST_FLOW_PX: Final = 0.3
# Below this length the cost is a parabola, so that it has a gradient at its end.
_ROUND_PX: Final = 0.01


@dataclass(frozen=True)
class ObjectMotionSettings:
    """How Gaussians may move.

    Args:
        rows: Degree of the polynomial: 1 is a velocity, 2 a velocity that changes evenly.
        cost: What a Gaussian that moves by 1 px in half the exposure has to explain for it: absolute error in full
            scales, summed over the pixels.
    """

    rows: int = 2
    cost: float = 0.02

    def check(self) -> "ObjectMotionSettings":
        """Return self if the numbers make sense.

        Raises:
            InputError: No rows or too many, or a cost that is negative or not finite.
        """
        if not 1 <= self.rows <= MOST_ROWS or not 0 <= self.cost < np.inf:
            raise InputError(
                f"a motion of {self.rows} rows at a cost of {self.cost:g}",
                allowed=f"1 to {MOST_ROWS} rows and a cost of at least 0",
            )
        return self

    def penalty(self, scene: Gaussians, px_per_length: float, pixels: int) -> Tensor | float:
        """Return what a scene's motion costs, in the unit of the mean absolute error; 0 where nothing can move.

        Args:
            scene: The Gaussians.
            px_per_length: How far a scene unit is in the picture, px.
            pixels: How many the picture has.
        """
        if scene.motion is None or not self.cost:
            return 0.0
        lengths = (scene.motion.square().sum(dim=2) + (_ROUND_PX / px_per_length) ** 2).sqrt()
        return (self.cost * px_per_length / pixels) * lengths.sum()


def set_moving(start: Gaussians, geometry: Geometry, views: F32, settings: ObjectMotionSettings) -> Gaussians:
    """Return first Gaussians with the motion that the views show of them.

    Args:
        start: Where they stand in the reference view.
        geometry: Poses and depth.
        views: Views to see motion in, [N, H, W, C].
        settings: How many rows there are; all but the first begin at zero.
    """
    times = mask_times(len(views)).double().numpy()
    seen = velocity(views, geometry, times)
    seen[np.linalg.norm(seen, axis=2) < _LEAST_FLOW_PX] = 0
    pose = geometry.world_to_camera[geometry.reference]
    in_camera = start.means.double().numpy() @ pose[:3, :3].T + pose[:3, 3]
    depth = in_camera[:, 2]
    at = (in_camera / np.where(depth > 0, depth, 1)[:, None]) @ geometry.intrinsics.T
    height, width = seen.shape[:2]
    column, row = (np.clip(np.nan_to_num(at[:, k]), 0, n - 1).astype(int) for k, n in ((0, width), (1, height)))
    inside = (depth > 0) & (at[:, 0] >= 0) & (at[:, 0] < width) & (at[:, 1] >= 0) & (at[:, 1] < height)
    rates = np.where(inside[:, None], seen[row, column], 0) / geometry.intrinsics.diagonal()[:2] * depth[:, None]
    motion = torch.zeros(len(start), settings.rows, 3)
    motion[:, 0] = torch.from_numpy(np.concatenate([rates, np.zeros((len(rates), 1))], axis=1) @ pose[:3, :3])
    # The motion counts from the middle of the exposure.
    means = start.means - motion[:, 0] * float(times[geometry.reference])
    return replace(start, means=means, motion=motion)


def at_rest_until_moved(scene: Gaussians, settings: ObjectMotionSettings) -> Gaussians:
    """Return Gaussians that may move and do not yet."""
    return replace(scene.detach(), motion=torch.zeros(len(scene), settings.rows, 3))


def of_degree(scene: Gaussians, number: int) -> Gaussians:
    """Return Gaussians with all rows of their motion for every second of several fits, and the first for the others.

    What errs in different ways averages better: a velocity has too little freedom, a change of it too much.
    """
    return scene if scene.motion is None or number % 2 else replace(scene, motion=scene.motion[:, :1])


def moving_share(scene: Gaussians) -> float:
    """Return the share of a scene's opacity that moves."""
    if scene.motion is None or not len(scene):
        return 0.0
    opacity = torch.sigmoid(scene.opacity_logits.detach())
    moves = scene.motion.detach().abs().amax(dim=(1, 2)) > 0
    return float((opacity * moves).sum() / opacity.sum())
