"""A scene in axes with y up and z behind: half a turn about x from ours, with y down and z ahead.

Here: the turned scene, with unit quaternions. Not here: the files that want it (`spz`, `glb`).
"""

from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import turned

HALF_TURN: Final = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
"""y_up_from_ours, [3, 3]."""


def half_turned(scene: Gaussians) -> Gaussians:
    """Return a scene in axes with y up, float64, its quaternions of norm 1; its motion is left out.

    Args:
        scene: The Gaussians, in our axes.
    """
    own = scene.detach().map(torch.Tensor.double)
    # Conjugation by the half turn changes the signs of y and z alone; the turn itself only relabels a Gaussian's axes,
    # whose signs do not matter.
    turn = torch.tensor([1.0, 1, -1, -1], dtype=torch.float64)
    return replace(
        own,
        means=own.means @ HALF_TURN,
        quaternions=unit_quaternions(own.quaternions) * turn,
        harmonics=None if own.harmonics is None else turned(own.harmonics, HALF_TURN),
        motion=None,
    )


def unit_quaternions(quaternions: Tensor) -> Tensor:
    """Return quaternions of norm 1, [G, 4]; the identity for those of norm 0."""
    unit = torch.nn.functional.normalize(quaternions, dim=1)
    return torch.where(unit.norm(dim=1, keepdim=True) > 0, unit, unit.new_tensor([1.0, 0, 0, 0]))
