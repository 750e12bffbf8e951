"""Adam (Kingma and Ba 2015), step by step for one tensor.

Here: the moments of one parameter and its step. Torch's class for many tensors does the same, but creating one imports
torch's compiler, which takes three seconds of a run that may have eight. Not here: rates, and which parameters there
are (`gaussians.py`, `poses.py`).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.gaussian_kernels import adam_step

DECAY: Final = 0.9
SQUARE_DECAY: Final = 0.999
# Gradients of a mean over pixels are as small as 1e-9 per Gaussian; with the usual 1e-8 the steps would vanish.
_EPSILON: Final = 1e-15


@dataclass(eq=False)
class Adam:
    """The number of steps made, and the moments of one parameter's gradients; None before the first.

    `decay` is that of the mean from step to step.
    """

    steps: int = 0
    mean: Tensor | None = None
    square: Tensor | None = None
    decay: float = DECAY

    def resume(self, other: "Adam", device: torch.device | None = None) -> None:
        """Go on from the moments of another, on a device; None: where they are."""
        self.steps = other.steps
        self.mean, self.square = (None if one is None else one.to(device) for one in (other.mean, other.square))

    def step(self, parameter: Tensor, rate: float) -> None:
        """Move a parameter against its gradient, in place; without a gradient it stays.

        Args:
            parameter: Any shape, in one piece of memory; of the same one each time, except for `follow`.
            rate: The step size.
        """
        if parameter.grad is not None:
            self.move(parameter.detach(), parameter.grad.contiguous(), rate)

    def move(self, values: Tensor, gradient: Tensor, rate: float) -> None:
        """Move numbers against their gradient, in place.

        Args:
            values: Any shape, in one piece of memory; of the same one each time, except for `follow`.
            gradient: By them.
            rate: The step size.
        """
        if self.mean is None or self.square is None:
            zeros = torch.zeros_like(values)
            self.mean, self.square = zeros, zeros.clone()
        self.steps += 1
        numbers = [one.view(-1) for one in (values, gradient, self.mean, self.square)]
        constants = (
            *(1 - self.decay, SQUARE_DECAY, 1 - SQUARE_DECAY),
            *((1 - SQUARE_DECAY**self.steps) ** -0.5, _EPSILON, rate / (1 - self.decay**self.steps)),
        )
        if values.dtype == torch.float32:
            call(adam_step, *numbers, np.array(constants, np.float32))
        else:  # the Gaussians' are many, and in float32; what is in float64 has a few hundred numbers, on the host
            value, slope, first, second = (one.numpy() for one in numbers)
            _adam_step(value, slope, first, second, np.array(constants))

    def widen(self, columns: int) -> None:
        """Continue with so many columns of a parameter [G, columns, ...]; the moments of new ones start at zero."""
        if self.mean is not None and self.square is not None:
            self.mean, self.square = (_columns(one, columns) for one in (self.mean, self.square))

    def follow(self, source: Tensor, *, forget: bool) -> None:
        """Continue with other rows of the parameter.

        Args:
            source: [G'] int64: which of the present rows each new one continues, or -1 if its moments start at zero.
            forget: Whether all moments start at zero.
        """
        if self.mean is not None:
            source = source.to(self.mean.device)
        kept = source >= 0
        if self.mean is not None and self.square is not None:
            self.mean, self.square = (_rows(one, source, kept, forget) for one in (self.mean, self.square))


def _adam_step(
    parameter: NDArray[Any], gradient: NDArray[Any], mean: NDArray[Any], square: NDArray[Any], constants: NDArray[Any]
) -> None:
    """As `adam_step`, without being compiled."""
    taken, decay, fresh, scale, least, step = constants
    mean += taken * (gradient - mean)
    square *= decay
    square += fresh * gradient * gradient
    parameter -= step * mean / (np.sqrt(square) * scale + least)


def _columns(moment: Tensor, columns: int) -> Tensor:
    added = moment.new_zeros((len(moment), columns - moment.shape[1], *moment.shape[2:]))
    return torch.cat([moment, added], dim=1)


def _rows(moment: Tensor, source: Tensor, kept: Tensor, forget: bool) -> Tensor:
    rows = moment.new_zeros((len(source), *moment.shape[1:]))
    if not forget:
        rows[kept] = moment[source[kept]]
    return rows
