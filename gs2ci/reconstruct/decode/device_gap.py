"""Accelerated GAP with total variation in torch, on a device: the arithmetic of `kernels.py`, to rounding.

Here: its loop over given views, one residual of each step read back. Not here: what it computes and why (`kernels.py`),
where it begins, and which decodes take this way (`pnp.py`). Never run on a GPU so far.
"""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32


def gap_on_device(
    views: F32,
    equation: tuple[F32, F32, F32],
    target: F32,
    levels: list[tuple[float, F32 | None, float]],
    denoise: tuple[float, int],
    told: Callable[[int, float], None],
    device: torch.device,
) -> F32:
    """Step from views to views.

    Args:
        views: To begin with, [N, C, H, W]; a single one stands for all.
        equation: wᵢ Mᵢ, [N, H, W]; the readings, [C, H, W]; and the inverse of the equation's energy, [H, W].
        target: The readings with the accumulated residual, [C, H, W].
        levels: Of each step: the denoiser's level; the noise per energy, [C, H, W], or None; the power of the views'
            error. See `kernels.project_onto_measurement`.
        denoise: The weight of total variation per level, and the steps of its denoiser.
        told: Is told of each step and the squared residual before it.
        device: Where.

    Returns:
        The views, [N, H, W, C].
    """
    now, goal, masks, measured, inverse = (
        torch.from_numpy(np.ascontiguousarray(one)).to(device) for one in (views, target, *equation)
    )
    for step, (sigma, noise, power) in enumerate(levels):
        weighed = None if noise is None else torch.from_numpy(noise).to(device)
        now, goal, energy = projected(now, goal, masks, measured, inverse, weighed, power)
        told(step + 1, float(energy))
        now = smoothed(now, denoise[0] * sigma, denoise[1])
    return now.movedim(1, -1).contiguous().cpu().numpy()


def projected(
    views: Tensor,
    target: Tensor,
    masks: Tensor,
    measured: Tensor,
    inverse_energy: Tensor,
    noise: Tensor | None,
    error_power: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return views and target after a step, and the squared residual before; see `kernels.project_onto_measurement`."""
    forward = (masks[:, None] * views).sum(dim=0)
    residual = measured - forward
    energy = (residual.double().square() * (inverse_energy > 0)).sum()
    reached = target + residual
    share = torch.zeros_like(measured) if noise is None else noise / error_power
    if noise is not None:
        reached = torch.where(noise > 0, measured + (1 - share).clamp(min=0) * (reached - measured), reached)
    change = (reached - forward) * inverse_energy / share.clamp(min=1)
    return views + masks[:, None] * change, reached, energy


def smoothed(views: Tensor, weight: float, inner: int) -> Tensor:
    """Return views of less total variation, [N, C, H, W]; see `kernels.denoise_planes`."""
    down, right = torch.zeros_like(views), torch.zeros_like(views)

    def primal() -> Tensor:
        found = down + right
        found[..., 1:, :] -= down[..., :-1, :]
        found[..., 1:] -= right[..., :-1]
        return views + weight * found

    for _ in range(inner):
        image = primal()
        down[..., :-1, :] += image.diff(dim=-2) / (8 * weight)
        right[..., :-1] += image.diff(dim=-1) / (8 * weight)
        length = (down.square() + right.square()).sqrt().clamp(min=1)
        down, right = down / length, right / length
    return primal()
