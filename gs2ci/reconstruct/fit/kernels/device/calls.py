"""The kernels of a fit on a device: each has the name, the arguments and the effect of Numba's.

Sums have an order of their own, so that results agree to rounding only; it is the same from run to run. Nothing is
read back: what Numba's kernels return as a number is a tensor [] here. Never run on a GPU so far. Here: the calls, by
which `fit.calling` finds what takes a kernel's place; most are one launch with a thread for each element. Not here:
what they compute and why (the kernel of the same name), the code that runs there (`kernels.py`).
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.reconstruct.fit.kernels.device import kernels
from gs2ci.reconstruct.fit.kernels.device.prepared import KeptLaunch

_LAUNCHES: Final = {
    **{one.key: KeptLaunch(one) for one in kernels.BY_ELEMENTS},
    **{one.key: KeptLaunch(one, int(kernels.SUMMED)) for one in kernels.BY_BLOCKS},
}


def counterpart(name: str) -> Callable[..., Any]:
    """Return what takes the place of the kernel of a name."""
    return _WITH_MORE.get(name) or partial(_each, name)


def _each(name: str, *arguments: Any) -> None:
    """Launch a thread for each element of the first argument."""
    _LAUNCHES[name](len(arguments[0]), *arguments)


def _sum(name: str, over: Tensor, *arguments: Any) -> Tensor:
    """Sum block by block over so many elements as a tensor has, which is given with the further arguments."""
    sums = over.new_empty(-(-len(over) // int(kernels.CHUNK)), dtype=torch.float64)
    _LAUNCHES[name](len(sums), *arguments, sums)
    return sums.sum()


def _mean(parameter: Tensor, weight: float, gradient: Tensor, *, opacities: bool) -> Tensor:
    """See `gaussian_kernels.add_opacity_gradient` and `add_size_gradient`."""
    count = len(parameter)
    if not count:
        return parameter.new_zeros(())
    return _sum("sum_values", parameter, parameter, weight / count, int(opacities), gradient) / count


def _gather_gradient(means: Tensor, *others: Any) -> None:
    *given, gradient = others
    changes = means.new_empty(len(means), 4, dtype=torch.float64)
    _each("find_changes", means, *given, np.array(gradient.shape, np.float64) - 1, changes)
    _LAUNCHES["sum_at_knots"](gradient.numel(), changes, *gradient.shape[1:], gradient.view(-1))


def _move_gaussians(means: Tensor, *others: Any) -> None:
    *given, field = others
    _each("move_gaussians", means, *given, torch.from_numpy(field).to(means.device))


def _move_map(inverse_depth: Tensor, pixels: Tensor, *others: Any) -> None:
    *given, field = others
    there = torch.from_numpy(field).to(inverse_depth.device)
    _LAUNCHES["move_map"](len(pixels), inverse_depth, pixels, *given, there)


def _distance_to_surface(
    image: Tensor, pixels: Tensor, inverse_depth: Tensor, trust: Tensor, *numbers_and_gradient: Any
) -> Tensor:
    all_trust = trust[pixels].sum(0, keepdim=True, dtype=torch.float64).clamp(min=1)
    return _sum("sum_distances", pixels, image, pixels, inverse_depth, trust, all_trust, *numbers_and_gradient)


_WITH_MORE: Final[dict[str, Callable[..., Any]]] = {
    "add_opacity_gradient": partial(_mean, opacities=True),
    "add_size_gradient": partial(_mean, opacities=False),
    "gather_gradient": _gather_gradient,
    "move_gaussians": _move_gaussians,
    "move_map": _move_map,
    "distance_to_surface": _distance_to_surface,
}
"""Of the kernels that take more than such a launch."""
