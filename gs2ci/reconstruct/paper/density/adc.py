"""Adaptive density control of 3D Gaussian splatting (Kerbl et al. 2023, section 5.2; gsplat's defaults).

Here: the rule, put together from `fit/density/classic.py`.
"""

from dataclasses import dataclass, field

import torch

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange, grow, within
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class Adc:
    """Split large and duplicate small Gaussians whose gradient is high; remove those that are faint or huge.

    Copies and children keep the opacity of the one they come from, as in the original.

    Args:
        criteria: Thresholds and the reset of opacities.
    """

    criteria: Classic = field(default_factory=Classic)
    name: str = "adc"

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the population that the fit goes on with."""
        remove = self.criteria.removed(scene, evidence)
        split, duplicate = self.criteria.divide(scene, evidence, self.criteria.wanting(evidence))
        room = evidence.cap - (len(scene) - int(remove.sum()))
        split, duplicate = within(room, evidence.screen_gradient, split & ~remove, duplicate & ~remove)
        change = grow(scene, ~(remove | split), duplicate, split, generator, preserving="neither")
        return self.criteria.reset(change, evidence)

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> None:
        """Move nothing."""
