"""The kernels of a fit in torch, for tensors on a device: each has the name, the arguments and the effect of Numba's.

Sums have an order of their own, so that results agree to rounding only; no float is added atomically, so that they are
the same from run to run. Nothing is read back: what Numba's kernels return as a number is a tensor [] here. Never run
on a GPU so far. Here: the counterparts. Not here: what they compute and why (the kernel of the same name), the call
(`calling.py`).
"""

from typing import Any

import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.fit.kernels.distances import FARTHEST, MOST_GROWTH


def _there(values: Any, like: Tensor, dtype: torch.dtype | None = None) -> Tensor:
    """Return numbers of the host beside a tensor."""
    return torch.as_tensor(values).to(device=like.device, dtype=dtype or like.dtype)


def adam_step(parameter: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, constants: Any) -> None:
    """See `gaussian_kernels.adam_step`."""
    taken, decay, fresh, scale, least, step = (float(one) for one in constants)
    mean.add_(gradient - mean, alpha=taken)
    square.mul_(decay).addcmul_(gradient, gradient, value=fresh)
    parameter.sub_(step * mean / (square.sqrt() * scale + least))


def add_opacity_gradient(logits: Tensor, weight: float, gradient: Tensor) -> Tensor:
    """See `gaussian_kernels.add_opacity_gradient`."""
    if not len(logits):
        return logits.new_zeros(())
    opacities = torch.sigmoid(logits)
    gradient.add_(opacities * (1 - opacities), alpha=weight / len(logits))
    return opacities.mean(dtype=torch.float64)


def add_size_gradient(log_scales: Tensor, weight: float, gradient: Tensor) -> Tensor:
    """See `gaussian_kernels.add_size_gradient`."""
    if not len(log_scales):
        return log_scales.new_zeros(())
    sizes = log_scales.exp()
    gradient.add_(sizes, alpha=weight / len(log_scales))
    return sizes.mean(dtype=torch.float64)


def _seen(means: Tensor, pose: F64) -> tuple[Tensor, Tensor]:
    """Return camera coordinates, [G, 3] float64, and the rotation, [3, 3]."""
    there = _there(pose, means, torch.float64)
    return means.double() @ there[:3, :3].T + there[:3, 3], there[:3, :3]


def gradient_in_view(
    means: Tensor, by_means: Tensor, by_log_scales: Tensor, pose: F64, near: float, gradient: Tensor
) -> None:
    """See `view_steps.gradient_in_view`."""
    seen, rotation = _seen(means, pose)
    turned = by_means.double() @ rotation.T
    z = seen[:, 2:]
    deep = -z * ((seen * turned).sum(dim=1, keepdim=True) + by_log_scales.double().sum(dim=1, keepdim=True))
    in_view = torch.cat([z * turned[:, :2], deep], dim=1)
    gradient.copy_(torch.where(z <= near, turned, in_view))


def move_in_view(
    means: Tensor, log_scales: Tensor, steps: Tensor, pose: F64, near: float, across: float, inverse: float
) -> None:
    """See `view_steps.move_in_view`."""
    seen, rotation = _seen(means, pose)
    wanted, z = steps.double(), seen[:, 2:]
    behind = z <= near
    safe = torch.where(behind, 1.0, z)
    most = _most_growth(safe)
    change = torch.minimum(torch.maximum(safe * inverse * wanted[:, 2:], -most / (1 + most)), _like(safe, MOST_GROWTH))
    farther = 1 / (1 + change)
    moved = (farther - 1) * seen
    moved[:, :2] += safe * farther * across * wanted[:, :2]
    log_scales.add_(torch.where(behind, 0.0, farther.log()).to(log_scales.dtype))
    means.add_((torch.where(behind, across * wanted, moved) @ rotation).to(means.dtype))


def _like(tensor: Tensor, value: float) -> Tensor:
    return torch.full_like(tensor, value)


def _most_growth(distance: Tensor) -> Tensor:
    """See `distances.most_growth`."""
    return (FARTHEST / distance - 1).clamp(min=0.0, max=MOST_GROWTH)


def _bounded(growth: Tensor, distance: Tensor) -> Tensor:
    """See `distances.bounded`."""
    return torch.minimum(growth.clamp(min=-MOST_GROWTH), _most_growth(distance))


def step_of_gaussians(
    means: Tensor, pose: F64, bend: F64, near: float, widest: float, by_means: Tensor, by_sizes: Tensor
) -> Tensor:
    """See `relief_kernels.step_of_gaussians`."""
    seen, rotation = _seen(means, pose)
    depth = seen[:, 2].clamp(min=near)
    slant = (seen[:, :2] @ _there(bend, seen) / depth).clamp(-widest, widest)
    # As the distances that are stored: the median is one of them.
    nearer = (depth * (1 + slant * slant)).to(by_sizes.dtype)
    shrink = nearer.median()
    growth = shrink - nearer
    by_means.copy_(growth[:, None] * (seen @ rotation))
    by_sizes.copy_(growth)
    return shrink


def derivative_along(gradient: Tensor, step: Tensor) -> Tensor:
    """See `relief_kernels.derivative_along`."""
    return (gradient.double() * step.double()).sum()


def take_step(means: Tensor, log_scales: Tensor, by_means: Tensor, by_sizes: Tensor, beta: Any) -> None:
    """See `relief_kernels.take_step`."""
    sizes = by_sizes.double()[:, None]
    still = sizes == 0
    safe = torch.where(still, 1.0, sizes)
    distance = torch.linalg.vector_norm(by_means.double(), dim=1, keepdim=True) / safe.abs()
    growth = _bounded(beta * safe, torch.where(still, 1.0, distance))
    growth = torch.where(still, 0.0, growth)
    means.add_((growth / safe * by_means.double()).to(means.dtype))
    log_scales.add_(growth.to(log_scales.dtype))


def _hats(at: Tensor, low: float, step: float, count: int) -> Tensor:
    """Return the weights of a grid's knots at positions, [P, count]: two of each row are not zero, and sum up to 1."""
    along = ((at - low) / step).clamp(0.0, count - 1.0)
    knots = torch.arange(count, dtype=along.dtype, device=along.device)
    return (1 - (along[:, None] - knots).abs()).clamp(min=0.0)


def _shares(u: Tensor, v: Tensor, w: Tensor, low: F64, step: F64, shape: tuple[int, ...]) -> list[Tensor]:
    return [_hats(at, float(low[k]), float(step[k]), shape[k]) for k, at in enumerate((u, v, w))]


def _field_at(field: F64, u: Tensor, v: Tensor, w: Tensor, low: F64, step: F64) -> Tensor:
    """Return a field, [A, B, C], at positions, [P]."""
    shares = _shares(u, v, w, low, step, field.shape)
    return torch.einsum("pa,pb,pc,abc->p", *shares, _there(field, u))


def gather_gradient(
    means: Tensor,
    by_means: Tensor,
    by_log_scales: Tensor,
    pose: F64,
    near: float,
    low: F64,
    step: F64,
    gradient: Tensor,
) -> None:
    """See `depth_field_kernels.gather_gradient`."""
    seen, rotation = _seen(means, pose)
    z = seen[:, 2]
    before = z >= near
    safe = torch.where(before, z, 1.0)
    along = (by_means.double() @ rotation.T * seen).sum(dim=1) + by_log_scales.double().sum(dim=1)
    total = torch.where(before, -safe * along, 0.0)
    a, b, c = _shares(seen[:, 0] / safe, seen[:, 1] / safe, 1 / safe, low, step, tuple(gradient.shape))
    # One product of matrices, whose sums have one order: no knot is added to by several Gaussians at once.
    rest = (b[:, :, None] * c[:, None, :]).flatten(1)
    gradient.copy_(((a * total[:, None]).T @ rest).reshape(gradient.shape))


def move_gaussians(means: Tensor, log_scales: Tensor, pose: F64, near: float, low: F64, step: F64, field: F64) -> None:
    """See `depth_field_kernels.move_gaussians`."""
    seen, rotation = _seen(means, pose)
    z = seen[:, 2]
    before = z >= near
    safe = torch.where(before, z, 1.0)
    change = -safe * _field_at(field, seen[:, 0] / safe, seen[:, 1] / safe, 1 / safe, low, step)
    growth = torch.where(before, _bounded(change, safe), 0.0)[:, None]
    means.add_((growth * (seen @ rotation)).to(means.dtype))
    log_scales.add_(growth.to(log_scales.dtype))


def move_map(
    inverse_depth: Tensor, pixels: Tensor, rays: Tensor, to_reference: F64, low: F64, step: F64, field: F64
) -> None:
    """See `depth_field_kernels.move_map`."""
    found, ray = inverse_depth[pixels].double(), rays[pixels].double()
    m = _there(to_reference, found)
    x, y, z = (m[k, 0] * ray[:, 0] + m[k, 1] * ray[:, 1] + m[k, 2] + m[k, 3] * found for k in range(3))
    moves = (found > 0) & (z > 0)
    safe = torch.where(moves, z, 1.0)
    moved = (found + _field_at(field, x / safe, y / safe, found / safe, low, step)).clamp(min=0.0)
    inverse_depth[pixels] = torch.where(moves, moved, found).to(inverse_depth.dtype)


def parallax_moments(means: Tensor, ray: Tensor, near: float, parallax_px: float, middle: float, out: Tensor) -> None:
    """See `surface_kernels.parallax_moments`."""
    parallax = parallax_px / (means @ ray[:3] + ray[3]).clamp(min=near) - middle
    out.copy_(torch.stack([torch.ones_like(parallax), parallax, parallax * parallax], dim=1))


def add_mean_gradient(
    means: Tensor, ray: Tensor, near: float, parallax_px: float, moments: Tensor, by_moments: Tensor, out: Tensor
) -> None:
    """See `surface_kernels.add_mean_gradient`."""
    depth = means @ ray[:3] + ray[3]
    before = depth >= near
    safe = torch.where(before, depth, 1.0)
    by_parallax = by_moments[:, 1] + 2 * moments[:, 1] * by_moments[:, 2]
    by_depth = torch.where(before, -by_parallax * parallax_px / (safe * safe), 0.0)
    out.add_(by_depth[:, None] * ray[:3])


def distance_to_surface(
    image: Tensor,
    pixels: Tensor,
    inverse_depth: Tensor,
    trust: Tensor,
    parallax_px: float,
    middle: float,
    round_px: float,
    weight: float,
    gradient: Tensor,
) -> Tensor:
    """See `surface_kernels.distance_to_surface`."""
    sure, seen = trust[pixels].double(), image[pixels].double()
    all_trust = sure.sum().clamp(min=1.0)
    p = parallax_px * inverse_depth[pixels].double() - middle
    square = seen[:, 2] - 2 * p * seen[:, 1] + p * p * seen[:, 0]
    root = (square.clamp(min=0.0) + round_px * round_px).sqrt()
    slope = torch.where(square >= 0, weight / all_trust * sure / (2 * root), 0.0)
    gradient[pixels] = torch.stack([slope * p * p, -2 * slope * p, slope], dim=1).to(gradient.dtype)
    return (sure * (root - round_px)).sum() / all_trust


def exchange_inverse_depth(
    inverse_depth: Tensor, rays: Tensor, bend: Tensor, beta: Any, shrink: Any, widest: float, out: Tensor
) -> None:
    """See `surface_kernels.exchange_inverse_depth`."""
    slant = (rays @ bend.to(rays.dtype)).clamp(-widest, widest)
    out.copy_((inverse_depth + beta * (1 + slant * slant)) * (1 - beta * shrink))
