"""The inner loops of a plane sweep in torch, on a device: the arithmetic of `kernels.matching_cost` and `best_plane`.

Sums have an order of their own, so that costs agree to rounding. The paths of the smoothing take a step for each column
and each row, all rows or columns at once: a few thousand launches a map. Never run on a GPU so far. Here: these loops.
Not here: what they compute and why (`kernels.py`), the sweep (`sweep.py`).
"""

from typing import Final

import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.depth.kernels import LARGE_JUMP, SMALL_JUMP, TRUNCATED_AT, UNSEEN_COST

# As in `kernels.py`.
_LEAST_DEPTH: Final = 1e-3
_LEAST_BEND: Final = 1e-9


def best_planes_on_device(features: F32, homographies: F64, best: int, window: int, device: torch.device) -> F32:
    """Find the plane of each pixel of the first view, with its fraction, [H, W]; one image is read back.

    Args:
        features: Of the reference view and the others, [1 + V, H, W, 8].
        homographies: As for `kernels.matching_cost`, [D, V, 3, 3].
        best: As there.
        window: As there.
        device: Where to compute.
    """
    there, through = torch.from_numpy(features).to(device), torch.from_numpy(homographies).to(device)
    costs = [_matching_cost(there[0], there[1:], plane, best, window) for plane in through]
    index: F32 = _best_plane(torch.stack(costs, dim=-1)).cpu().numpy()
    return index


def _matching_cost(reference: Tensor, views: Tensor, homographies: Tensor, best: int, window: int) -> Tensor:
    """Compare the reference view, [H, W, 8], with others, [V, H, W, 8], on one plane, [V, 3, 3]; [H, W]."""
    height, width = reference.shape[:2]
    rows = torch.arange(height, dtype=torch.float64, device=reference.device)[:, None]
    columns = torch.arange(width, dtype=torch.float32, device=reference.device)
    u, v, z = (
        (homographies[:, k, 1, None, None] * rows + homographies[:, k, 2, None, None]).float()
        + homographies[:, k, 0, None, None].float() * columns
        for k in range(3)
    )
    inverse_z = 1 / z.clamp(min=_LEAST_DEPTH)
    u, v = u * inverse_z, v * inverse_z
    lost = (u < 0) | (u > width - 1) | (v < 0) | (v > height - 1) | (z < _LEAST_DEPTH)
    u, v = u.clamp(0, width - 1), v.clamp(0, height - 1)
    column, row = u.long().clamp(max=width - 2), v.long().clamp(max=height - 2)
    across, down = (u - column)[..., None], (v - row)[..., None]
    numbers = torch.arange(len(views), device=reference.device)[:, None, None]

    def at(below: int, right: int) -> Tensor:
        return views[numbers, row + below, column + right]

    upper = (1 - across) * at(0, 0) + across * at(0, 1)
    lower = (1 - across) * at(1, 0) + across * at(1, 1)
    apart = ((1 - down) * upper + down * lower - reference).abs().sum(dim=-1).clamp(max=TRUNCATED_AT)
    apart = torch.where(lost, UNSEEN_COST, apart)
    means = torch.nn.functional.avg_pool2d(apart, window, stride=1, padding=window // 2, count_include_pad=False)
    return means.sort(dim=0).values[:best].mean(dim=0)


def _best_plane(cost: Tensor) -> Tensor:
    """Smooth the cost, [H, W, D], along both directions of rows and columns; the plane of least sum, [H, W]."""
    total = _paths(cost.transpose(0, 1)).transpose(0, 1) + _paths(cost)
    planes = cost.shape[2]
    place = total.argmin(dim=2, keepdim=True).clamp(1, planes - 2)
    before, here, after = (total.gather(2, place + shift)[..., 0] for shift in (-1, 0, 1))
    bend = (before - 2 * here + after).clamp(min=_LEAST_BEND)
    return place[..., 0] + ((before - after) / (2 * bend)).clamp(-0.5, 0.5)


def _paths(cost: Tensor) -> Tensor:
    """Sum the path costs of both directions along the first axis, [L, M, D]."""
    total = torch.zeros_like(cost)
    for order in (range(len(cost)), range(len(cost) - 1, -1, -1)):
        before: Tensor | None = None
        for i in order:
            if before is None:
                before = cost[i]
            else:
                least = before.amin(dim=1, keepdim=True)
                beside = torch.nn.functional.pad(before, (1, 1), value=torch.inf)
                step = torch.minimum(beside[:, :-2], beside[:, 2:]) + SMALL_JUMP
                before = cost[i] + (torch.minimum(torch.minimum(before, step), least + LARGE_JUMP) - least)
            total[i] += before
    return total
