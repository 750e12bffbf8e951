"""A good vectorised rasteriser in plain torch, written without kernels, as the reference for the speed of ours.

It does no needless work: Gaussians are projected once per view, the (pixel, Gaussian) pairs whose alpha reaches
the threshold are listed exactly, masked pixels are never listed, and only those pairs are evaluated. Autograd
differentiates the rest. It shares the image model of `tests.render.reference`, in float32, and never stops early.
"""

import torch
from torch import Tensor

from gs2ci.render.conventions import ALPHA_MAX, ALPHA_MIN
from gs2ci.render.gaussians import Gaussians
from tests.render.reference import Splats, project


def coded_sum(scene: Gaussians, world_to_camera: Tensor, intrinsics: Tensor, masks: Tensor) -> Tensor:
    """Render sum_i M_i * X_i, [H, W, 3], differentiably."""
    size = (int(masks.shape[1]), int(masks.shape[2]))
    total = torch.zeros(size[0] * size[1], 3)
    for pose, mask in zip(world_to_camera, masks, strict=True):
        opened = mask.reshape(-1).nonzero().squeeze(1)
        splats = project(scene, pose, intrinsics, size, scene.colours)
        colours = _blend(splats, opened, mask)
        total = total.index_add(0, opened, mask.reshape(-1)[opened, None] * colours)
    return total.reshape(*size, 3)


def _blend(splats: Splats, opened: Tensor, mask: Tensor) -> Tensor:
    """Blend splats over the opened pixels, [A, 3]."""
    var_x, cov, var_y = splats.covariances[:, 0, 0], splats.covariances[:, 0, 1], splats.covariances[:, 1, 1]
    slope = cov / var_y
    precision_t, precision_y = 1 / (var_x - slope * cov), 1 / var_y
    columns = (*splats.means.unbind(1), slope, precision_t, precision_y, splats.opacities)
    table = torch.stack([*columns, *splats.colours.unbind(1)])
    with torch.no_grad():
        splat, pixel = _pairs(table, var_x, var_y, mask)
        begins = torch.searchsorted(pixel, torch.arange(len(opened)))
    x0, y0, slope, precision_t, precision_y, opacity, *colour = table.index_select(1, splat).unbind(0)
    width = mask.shape[1]
    dx, dy = (opened % width + 0.5)[pixel] - x0, (opened // width + 0.5)[pixel] - y0
    t = dx - slope * dy
    alpha = opacity * torch.exp(-0.5 * (precision_t * t * t + precision_y * dy * dy))
    alpha = torch.where(alpha >= ALPHA_MIN, alpha.clamp(max=ALPHA_MAX), torch.zeros_like(alpha))
    # Transmittance before each pair: one running sum of logs over all pixels, less its value where the pixel
    # begins. In float64, as the sum runs over a million pairs.
    through = torch.log1p(-alpha).double()
    before = torch.cumsum(through, 0) - through
    before = torch.cat([before, before.new_zeros(1)])
    arriving = torch.exp((before[:-1] - before[begins][pixel]).float())
    weight = alpha * arriving
    shares = weight * torch.stack(colour)
    return torch.zeros(3, len(opened)).index_add(1, pixel, shares).T


def _pairs(table: Tensor, var_x: Tensor, var_y: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """List (splat, opened pixel) with alpha >= ALPHA_MIN, by pixel and front to back.

    Row by row a footprint is an interval of columns; its opened pixels are consecutive in the list of all.
    """
    height, width = mask.shape
    x0, y0, slope, precision_t, precision_y, opacity = table[:6]
    reach = 2 * torch.log(opacity / ALPHA_MIN)  # squared Mahalanobis radius of the footprint
    extent_x, extent_y = (var_x * reach.clamp(min=0)).sqrt(), (var_y * reach.clamp(min=0)).sqrt()
    seen = (reach > 0) & (x0 + extent_x > 0) & (x0 - extent_x < width)
    top = torch.ceil(y0 - extent_y - 0.5).clamp(0, height)
    bottom = torch.floor(y0 + extent_y - 0.5).clamp(-1, height - 1)
    splat, row = _expand(torch.where(seen, (bottom - top + 1).clamp(min=0), torch.zeros_like(top)).long())
    row = row + top[splat].long()
    dy = row + 0.5 - y0[splat]
    half = ((reach[splat] - precision_y[splat] * dy * dy).clamp(min=0) / precision_t[splat]).sqrt()
    centre = x0[splat] + slope[splat] * dy
    left = torch.ceil(centre - half - 0.501).clamp(0, width).long()
    right = torch.floor(centre + half - 0.499).clamp(-1, width - 1).long()
    # opened_before[y, x]: opened pixels of the image before column x of row y, in reading order.
    opened = (mask > 0).reshape(-1).long()
    opened_before = torch.cat([opened.new_zeros(1), opened.cumsum(0)])
    first = opened_before[row * width + left]
    count = (opened_before[row * width + right + 1] - first).clamp(min=0)
    count = torch.where(right >= left, count, torch.zeros_like(count))
    interval, within = _expand(count)
    pixel = first[interval] + within
    # Splats come front to back; a stable sort by pixel keeps that order within each pixel. Sorting int32 takes
    # half the time of int64, and the largest pixel's index fits.
    pixel, order = torch.sort(pixel.int(), stable=True)
    return splat[interval][order], pixel.long()


def _expand(counts: Tensor) -> tuple[Tensor, Tensor]:
    """Return, for counts (2, 0, 3), the indices (0, 0, 2, 2, 2) and the running numbers (0, 1, 0, 1, 2)."""
    index = torch.repeat_interleave(torch.arange(len(counts)), counts)
    starts = torch.cumsum(counts, 0) - counts
    return index, torch.arange(len(index)) - starts[index]
