"""What renderings show of each Gaussian on the screen: how the loss pulls at it there, and how large it appears.

Here: the record, which a backend fills during its backward pass when it was given one. Not here: decisions on it
(`gs2ci.reconstruct.fit.density`).
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

RADIUS_SIGMAS: Final = 3.0
"""A Gaussian's radius on the screen is this many standard deviations along its longer axis (Kerbl et al. 2023; they
round up to whole pixels, here it stays as it is)."""


@dataclass
class ScreenStatistics:
    """Sums over all sightings: every view of every rendering in which a Gaussian can touch a pixel is one.

    Args:
        gradient_sum: Of the norm of dL/d(screen position), one view's at a time, [G]. The position is counted in
            half image widths and heights, as Kerbl et al. (2023) and gsplat do.
        sightings: Their number, [G] float32.
        radius_px: The largest radius seen, [G].
    """

    gradient_sum: Tensor
    sightings: Tensor
    radius_px: Tensor

    @classmethod
    def empty(cls, count: int) -> "ScreenStatistics":
        """Return the record of `count` Gaussians that nobody has seen yet."""
        return cls(torch.zeros(count), torch.zeros(count), torch.zeros(count))

    def add(self, gradient_sum: Tensor, sightings: Tensor, radius_px: Tensor) -> None:
        """Take in one rendering's sums, [G] each."""
        self.gradient_sum += gradient_sum
        self.sightings += sightings
        self.radius_px = torch.maximum(self.radius_px, radius_px)

    def mean_gradient(self) -> Tensor:
        """Return the mean over the sightings, [G]; zero where there were none."""
        return self.gradient_sum / self.sightings.clamp(min=1)
