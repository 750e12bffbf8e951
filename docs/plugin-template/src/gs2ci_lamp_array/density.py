"""A density rule: nothing is added and nothing removed. What it may decide by: `gs2ci.reconstruct.fit.density.base`."""

from dataclasses import dataclass

import torch
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange
from gs2ci.reconstruct.fit.rules import RuleChoice
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class Still:
    """Keeps the Gaussians that the fit began with."""

    name: str = "still"

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        return PopulationChange(scene.detach(), torch.arange(len(scene.means)))

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> Tensor | None:
        return None


STILL = RuleChoice(Still)
