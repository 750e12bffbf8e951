"""The bas-relief mode of camera path and scene, as one parameter of the fit.

If a constant is added to all inverse depths and each camera is turned to undo the shift of its picture, the views
hardly change: a camera that turns a little looks like one that travels past something a little nearer (Belhumeur,
Kriegman and Yuille 1999; for motion, Daniilidis and Spetsakis 1997). Only perspective at the borders of the picture, a
few tenths of a pixel, tells the two apart. Poses and Gaussians with separate steps do not follow so shallow a valley in
a few hundred iterations, since every Gaussian would have to move with every camera. A step of this parameter moves all
of them together.

With the reference camera as the frame, X = z (u, v, 1), translations t_i of the others and e the direction across the
image in which most of them lie, the step by beta is, to first order,

    1/z  ->  1/z + beta (1 + ((u, v) . e)^2 - m / z),   camera i turns by beta (t_y, -t_x, 0), moves by beta m t_i,

where the square compensates the part of a turn's shift along the path that is not constant, and the terms with the
median depth m keep the scene's size. What it adds to inverse depths is a field over the reference view (`depth_field`).
What remains is a shift by -beta (t . u) across the path, in px times the focal length: it is zero in the middle of the
picture, and by it the measurement decides.

Here: the direction, and its steps. Not here: the field's gradient (`depth_field.py`), the poses (`optimiser/poses.py`).
"""

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.fit.optimiser.adam import Adam


class Relief:
    """Steps along that direction by Adam, from the gradients by the field's knots and by the poses."""

    def __init__(self) -> None:
        self._adam = Adam()

    def step(
        self, by_knots: F64, by_twists: Tensor, knots: tuple[F64, ...], travel: F64, rate: float
    ) -> tuple[F64, Tensor] | None:
        """Choose a step by the present gradients; the caller applies it.

        It is what to add to inverse depths at the field's knots, [A, B, C], and the cameras' twists, applied after
        their poses, [N, 6]. None if the camera moves forward more than sideways, since then no turn looks like travel,
        and if a gradient is not finite.

        Args:
            by_knots: Gradient by what is added to inverse depth at the field's knots, [A, B, C].
            by_twists: By twists applied after the poses, translation in scene units first, [N, 6].
            knots: u, v and 1/z of the field's knots in the reference view, [A], [B] and [C].
            travel: Positions of the reference camera seen from each one, [N, 3].
            rate: The step size, in units of inverse depth.
        """
        if not np.square(travel[:, :2]).sum() > np.square(travel[:, 2]).sum():
            return None
        values, twists = direction(knots, travel)
        slope = float((by_knots * values).sum() + (by_twists.double().numpy() * twists).sum())
        if not np.isfinite(slope):
            return None
        step = torch.zeros((), dtype=torch.float64)
        self._adam.move(step, step.new_tensor(slope), rate)
        beta = float(step)
        return beta * values, torch.from_numpy(beta * twists).to(by_twists.dtype)


def direction(knots: tuple[F64, ...], travel: F64) -> tuple[F64, F64]:
    """Return the derivatives by beta of what is added to inverse depths, [A, B, C], and of the twists, [N, 6].

    Args:
        knots: See `Relief.step`; the middle one of 1/z stands for the scene's median.
        travel: See `Relief.step`.
    """
    across, down, inverse_depth = knots
    middle_depth = 1 / float(np.mean(inverse_depth[[0, -1]]))
    (along, aside), _ = np.linalg.svd(travel[:, :2], full_matrices=False)[2]
    slant = across[:, None] * along + down * aside
    values = 1 + np.square(slant)[..., None] - middle_depth * inverse_depth
    turns = np.stack([travel[:, 1], -travel[:, 0], np.zeros(len(travel))], axis=1)
    return values, np.concatenate([middle_depth * travel, turns], axis=1)
