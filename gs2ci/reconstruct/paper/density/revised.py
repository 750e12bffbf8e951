"""Revised densification (Rota Bulò et al. 2024, "Revising densification in Gaussian splatting").

Here: the rule. Candidates are chosen by their part in the error of the pixels instead of by gradients, duplicates
preserve the transmittance (splits do not: `fit/density/osgr.py` adds that), growth per application is bounded, and each
application lowers opacities a little instead of resetting them.
"""

from dataclasses import dataclass, field, replace

import torch

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange, grow, within
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.render.gaussians import Gaussians, logit


@dataclass(frozen=True)
class Revised:
    """Split or duplicate Gaussians that contribute to wrong pixels, the largest error first.

    Args:
        error: Part in the error of one view above which a Gaussian is split or duplicated. The error of a pixel is
            1 − SSIM; a pixel of a coded measurement passes it to every view that its masks let through.
        growth: Most additions in one application, as a share of the population.
        sinking: How much each application lowers every opacity.
        criteria: What is large, what is removed. Its gradient threshold and its reset are not used.
    """

    error: float = 0.1
    growth: float = 0.05
    sinking: float = 0.001
    criteria: Classic = field(default_factory=lambda: Classic(reset_every=None))
    name: str = "revised"

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the population that the fit goes on with."""
        remove = self.criteria.removed(scene, evidence)
        part = evidence.blended_error()
        split, duplicate = self.criteria.divide(scene, evidence, part > self.error)
        room = min(evidence.cap - (len(scene) - int(remove.sum())), int(self.growth * len(scene)))
        split, duplicate = within(room, part, split & ~remove, duplicate & ~remove)
        return self._sink(grow(scene, ~(remove | split), duplicate, split, generator, preserving="duplicates"))

    def _sink(self, change: PopulationChange) -> PopulationChange:
        scene = change.scene.map(lambda tensor: tensor)
        # In float64, so that opacities near one do not round to one; the least float32 is the lower bound.
        opacity = torch.sigmoid(scene.opacity_logits.double()) - self.sinking
        floor = torch.finfo(torch.float32).tiny
        scene.opacity_logits = logit(opacity.clamp(min=floor)).to(scene.opacity_logits.dtype)
        return replace(change, scene=scene)

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> None:
        """Move nothing."""
