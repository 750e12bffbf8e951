"""Screen statistics of each Gaussian: the loss's gradient by its screen position, and its size on the screen.

Here: the record, which a backend fills during its backward pass if one was given. Not here: decisions based on it
(`gs2ci.reconstruct.fit.density`).
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

RADIUS_SIGMAS: Final = 3.0
"""A Gaussian's radius on the screen is this many standard deviations along its longer axis (Kerbl et al. 2023, who
round up to whole pixels; here it is not rounded)."""


@dataclass
class ScreenStatistics:
    """Sums over sightings, that is, over the views of all renderings in which a Gaussian can touch a pixel.

    Args:
        gradient_sum: Sum over views of the norm of dL/d(screen position), [G]. The position is in half image widths and
            heights, as in Kerbl et al. (2023) and gsplat.
        sightings: Their number, [G] float32.
        radius_px: The largest radius seen, [G].
    """

    gradient_sum: Tensor
    sightings: Tensor
    radius_px: Tensor

    @classmethod
    def empty(cls, count: int, device: torch.device | None = None) -> "ScreenStatistics":
        """Return an empty record of `count` Gaussians, on a device; None: on the host."""
        return cls(*(torch.zeros(count, device=device) for _ in range(3)))

    def add(self, gradient_sum: Tensor, sightings: Tensor, radius_px: Tensor) -> None:
        """Add one rendering's sums, [G] each."""
        self.gradient_sum += gradient_sum
        self.sightings += sightings
        self.radius_px = torch.maximum(self.radius_px, radius_px)

    def mean_gradient(self) -> Tensor:
        """Return the mean over the sightings, [G]; zero if there were none."""
        return self.gradient_sum / self.sightings.clamp(min=1)
