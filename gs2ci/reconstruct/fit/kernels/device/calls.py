"""The kernels of a fit on a device: each has the name, the arguments and the effect of Numba's.

Sums have an order of their own, so that results agree to rounding only; it is the same from run to run. Nothing is
read back: what Numba's kernels return as a number is a tensor [] here. Never run on a GPU so far. Here: the calls, by
which `fit.calling` finds what takes a kernel's place. Not here: what they compute and why (the kernel of the same
name), the code that runs there (`kernels.py`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.fit.kernels.device import kernels
from gs2ci.reconstruct.fit.kernels.device.prepared import KeptLaunch

_SUMMED, _TOGETHER = int(kernels.SUMMED), int(kernels.CHUNK)

_adam_step = KeptLaunch(kernels.adam_step)
_gradient_in_view = KeptLaunch(kernels.gradient_in_view)
_move_in_view = KeptLaunch(kernels.move_in_view)
_step_together = KeptLaunch(kernels.step_together)
_sum_opacities = KeptLaunch(kernels.sum_opacities, _SUMMED)
_sum_sizes = KeptLaunch(kernels.sum_sizes, _SUMMED)
_sum_products = KeptLaunch(kernels.sum_products, _SUMMED)
_find_distances = KeptLaunch(kernels.find_distances)
_differentiate_step = KeptLaunch(kernels.differentiate_step)
_take_step = KeptLaunch(kernels.take_step)
_move_gaussians = KeptLaunch(kernels.move_gaussians)
_find_changes = KeptLaunch(kernels.find_changes)
_sum_at_knots = KeptLaunch(kernels.sum_at_knots, _SUMMED)
_parallax_moments = KeptLaunch(kernels.parallax_moments)
_add_mean_gradient = KeptLaunch(kernels.add_mean_gradient)
_sum_trust = KeptLaunch(kernels.sum_trust, _SUMMED)
_sum_distances = KeptLaunch(kernels.sum_distances, _SUMMED)


def _sums(count: int, like: Tensor) -> Tensor:
    """Return room for the sums of blocks over so many numbers."""
    return like.new_empty(-(-count // _TOGETHER), dtype=torch.float64)


def adam_step(parameter: Tensor, gradient: Tensor, mean: Tensor, square: Tensor, constants: Any) -> None:
    """See `gaussian_kernels.adam_step`."""
    _adam_step(len(parameter), parameter, gradient, mean, square, *constants.tolist())


def step_together(
    scene: Sequence[Tensor],
    means: Sequence[Tensor],
    squares: Sequence[Tensor],
    constants: Sequence[Sequence[float]],
    view: tuple[F64, float, float, float] | None,
) -> None:
    """Make Adam's steps of means, log scales, quaternions, opacity logits and colours, with their gradients, at once.

    Args:
        scene: These parameters, with gradients.
        means: First moments.
        squares: Second moments.
        constants: As for `adam_step`, [6] for each.
        view: Pose, nearest depth and units of `view_steps.move_in_view`, if positions step in the coordinates of a
            view, whose gradients then are taken from those of the means.
    """
    taken, decay, fresh, _, least, _ = constants[0]
    scales, steps = (np.array([one[k] for one in constants]) for k in (3, 5))
    pose, *units = view or (np.eye(4), 0.0, 0.0, 0.0)
    gradients = [one.grad.contiguous() for one in scene if one.grad is not None]
    arrays = [*(one.detach() for one in scene), *gradients, *means, *squares]
    numbers = (taken, decay, fresh, least, scales, steps)
    _step_together(len(scene[0]), *arrays, *numbers, int(view is not None), pose, *units)


def add_opacity_gradient(logits: Tensor, weight: float, gradient: Tensor) -> Tensor:
    """See `gaussian_kernels.add_opacity_gradient`."""
    return _mean(_sum_opacities, logits, weight, gradient)


def add_size_gradient(log_scales: Tensor, weight: float, gradient: Tensor) -> Tensor:
    """See `gaussian_kernels.add_size_gradient`."""
    return _mean(_sum_sizes, log_scales, weight, gradient)


def _mean(summing: KeptLaunch, values: Tensor, weight: float, gradient: Tensor) -> Tensor:
    count = len(values)
    if not count:
        return values.new_zeros(())
    sums = _sums(count, values)
    summing(len(sums), values, weight / count, gradient, sums)
    return sums.sum() / count


def gradient_in_view(
    means: Tensor, by_means: Tensor, by_log_scales: Tensor, pose: F64, near: float, gradient: Tensor
) -> None:
    """See `view_steps.gradient_in_view`."""
    _gradient_in_view(len(means), means, by_means, by_log_scales, pose, near, gradient)


def move_in_view(
    means: Tensor, log_scales: Tensor, steps: Tensor, pose: F64, near: float, across: float, inverse: float
) -> None:
    """See `view_steps.move_in_view`."""
    _move_in_view(len(means), means, log_scales, steps, pose, near, across, inverse)


def step_of_gaussians(
    means: Tensor, pose: F64, bend: F64, near: float, widest: float, by_means: Tensor, by_sizes: Tensor
) -> Tensor:
    """See `relief_kernels.step_of_gaussians`."""
    _find_distances(len(means), means, pose, bend, near, widest, by_sizes)
    shrink = by_sizes.median()
    _differentiate_step(len(means), means, pose, shrink.reshape(1), by_means, by_sizes)
    return shrink


def derivative_along(gradient: Tensor, step: Tensor) -> Tensor:
    """See `relief_kernels.derivative_along`."""
    sums = _sums(len(gradient), gradient)
    _sum_products(len(sums), gradient, step, sums)
    return sums.sum()


def take_step(means: Tensor, log_scales: Tensor, by_means: Tensor, by_sizes: Tensor, beta: float) -> None:
    """See `relief_kernels.take_step`."""
    _take_step(len(means), means, log_scales, by_means, by_sizes, beta)


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
    changes = means.new_empty(len(means), 4, dtype=torch.float64)
    most = np.array(gradient.shape, np.float64) - 1
    _find_changes(len(means), means, by_means, by_log_scales, pose, near, low, step, most, changes)
    _sum_at_knots(gradient.numel(), changes, *gradient.shape[1:], gradient.view(-1))


def move_gaussians(means: Tensor, log_scales: Tensor, pose: F64, near: float, low: F64, step: F64, field: F64) -> None:
    """See `depth_field_kernels.move_gaussians`."""
    there = torch.from_numpy(field).to(means.device)
    _move_gaussians(len(means), means, log_scales, pose, near, low, step, there)


def parallax_moments(means: Tensor, ray: Tensor, near: float, parallax_px: float, middle: float, out: Tensor) -> None:
    """See `surface_kernels.parallax_moments`."""
    _parallax_moments(len(means), means, ray, near, parallax_px, middle, out)


def add_mean_gradient(
    means: Tensor, ray: Tensor, near: float, parallax_px: float, moments: Tensor, by_moments: Tensor, out: Tensor
) -> None:
    """See `surface_kernels.add_mean_gradient`."""
    _add_mean_gradient(len(means), means, ray, near, parallax_px, moments, by_moments, out)


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
    sums, all_trust = _sums(len(pixels), image), image.new_empty(1, dtype=torch.float64)
    _sum_trust(1, pixels, trust, all_trust)
    numbers = (parallax_px, middle, round_px, weight)
    _sum_distances(len(sums), image, pixels, inverse_depth, trust, all_trust, *numbers, gradient, sums)
    return sums.sum()
