"""The inner loops of a plane sweep on a device: the arithmetic of `kernels.matching_cost` and `smoothed`.

The comparison is torch's, many planes at once; the paths of the smoothing are Warp's, one launch for each of the four
directions. Sums have an order of their own, so that costs agree to rounding. Never run on a GPU so far. Here: these
loops. Not here: what they compute and why (`kernels.py`), the sweep (`sweep.py`).
"""

from typing import Final

import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.depth.kernels import LEAST_DEPTH, TRUNCATED_AT, UNSEEN_COST, best_plane

AT_ONCE: Final = 16_000_000
"""Numbers that are looked up at once: 64 MB in each of some eight tensors."""


def best_planes_on_device(features: Tensor, homographies: F64, best: int, window: int) -> F32:
    """Find the plane of each pixel of the first view, with its fraction, [H, W]; one image is read back.

    Args:
        features: Of the reference view and the others, on the device, [1 + V, H, W, 8].
        homographies: As for `kernels.matching_cost`, [D, V, 3, 3].
        best: As there.
        window: As there.
    """
    through = torch.from_numpy(homographies).to(features.device)
    some = max(1, AT_ONCE // features[1:].numel())
    costs = [_matching_cost(features[0], features[1:], planes, best, window) for planes in torch.split(through, some)]
    return best_plane(_paths(torch.cat(costs).permute(1, 2, 0).contiguous())).cpu().numpy()


def _matching_cost(reference: Tensor, views: Tensor, homographies: Tensor, best: int, window: int) -> Tensor:
    """Compare the reference view, [H, W, 8], with others, [V, H, W, 8], on planes, [D, V, 3, 3]; [D, H, W]."""
    height, width = reference.shape[:2]
    rows = torch.arange(height, dtype=torch.float64, device=reference.device)[:, None]
    columns = torch.arange(width, dtype=torch.float32, device=reference.device)
    u, v, z = (
        (homographies[:, :, k, 1, None, None] * rows + homographies[:, :, k, 2, None, None]).float()
        + homographies[:, :, k, 0, None, None].float() * columns
        for k in range(3)
    )
    inverse_z = 1 / z.clamp(min=float(LEAST_DEPTH))
    u, v = u * inverse_z, v * inverse_z
    lost = (u < 0) | (u > width - 1) | (v < 0) | (v > height - 1) | (z < float(LEAST_DEPTH))
    # From -1 at the first pixel to 1 at the last.
    places = torch.stack([2 * u / (width - 1) - 1, 2 * v / (height - 1) - 1], dim=-1)
    pictures = views.permute(0, 3, 1, 2)
    shown = torch.stack(
        [torch.nn.functional.grid_sample(pictures, at, padding_mode="border", align_corners=True) for at in places]
    )
    apart = (shown - reference.permute(2, 0, 1)).abs().sum(dim=2).clamp(max=TRUNCATED_AT)
    apart = torch.where(lost, UNSEEN_COST, apart)
    means = torch.nn.functional.avg_pool2d(apart, window, stride=1, padding=window // 2, count_include_pad=False)
    return means.sort(dim=1).values[:, :best].mean(dim=1)


def _paths(cost: Tensor) -> Tensor:
    """Sum the path costs of both directions of rows and columns, [H, W, D]."""
    from gs2ci.reconstruct.geometry.depth.device_paths import add_paths  # noqa: PLC0415  an extra

    height, width, planes = cost.shape
    total, row = torch.zeros_like(cost), width * planes
    for lines, length, apart, step in ((height, width, row, planes), (width, height, planes, row)):
        for backwards in (False, True):
            add_paths(cost, total, (lines, length, apart, step), backwards=backwards)
    return total
