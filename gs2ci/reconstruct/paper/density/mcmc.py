"""3DGS-MCMC: a population of a given size that moves to where it is needed (Kheradmand et al. 2024).

Here: the rule. Faint Gaussians are relocated to the places of opaque ones, new ones are placed there too, and after
every iteration faint ones are shaken, the more the larger they are. Not here: opacities and sizes of Gaussians that
share a place (`sharing.py`); the two regularisers, mean opacity and mean size, which are weights of the loss
(`fit/losses/objective.py`).
"""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange
from gs2ci.reconstruct.paper.density.sharing import most_copies, share_out
from gs2ci.render.gaussians import Gaussians, rotation_matrices

_STEEPNESS: Final = 100.0  # with which shaking decreases with opacity (Kheradmand et al. 2024, section 4.2)


@dataclass(frozen=True)
class Mcmc:
    """Relocate the faint, add a share of newcomers, shake.

    Args:
        transparent: Opacity at or below which a Gaussian is relocated; shaking falls off around it.
        growth: Newcomers in one turn, as a share of the population, up to the cap.
        shaking: Step of the shaking in units of the means' step size, per square of a scene unit.
    """

    transparent: float = 0.005
    growth: float = 0.05
    shaking: float = 5e5
    name: str = "mcmc"

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the population that the fit goes on with."""
        present = scene.detach()
        opacity = torch.sigmoid(present.opacity_logits)
        faint = opacity <= self.transparent
        weights = torch.where(faint, 0.0, opacity)
        newcomers = max(0, min(evidence.cap, int((1 + self.growth) * len(scene))) - len(scene))
        wanted = int(faint.sum()) + newcomers
        if wanted == 0 or bool(faint.all()):  # no Gaussian moves, or there is none to move to
            return PopulationChange(present.map(torch.clone), torch.arange(len(scene)))
        chosen = torch.multinomial(weights, wanted, replacement=True, generator=generator)
        return self._move(present, faint, self._affordable(present, chosen))

    def _affordable(self, scene: Gaussians, chosen: Tensor) -> Tensor:
        """Drop choices that would divide a Gaussian into parts that are faint themselves and would be relocated."""
        order = torch.argsort(chosen, stable=True)
        first = torch.searchsorted(chosen[order], chosen[order])
        rank = torch.empty_like(chosen)
        rank[order] = torch.arange(len(chosen)) - first  # how many chose the same one before
        room = most_copies(scene.opacity_logits, self.transparent)[chosen] - 1
        return chosen[rank < room]

    def _move(self, scene: Gaussians, faint: Tensor, chosen: Tensor) -> PopulationChange:
        """Share each choice with one of the faint Gaussians, or with a new one when none of these is left."""
        copies = 1 + torch.bincount(chosen, minlength=len(scene))
        shared = copies > 1
        logits, log_scales = scene.opacity_logits.clone(), scene.log_scales.clone()
        logits[shared], log_scales[shared] = share_out(logits[shared], log_scales[shared], copies[shared])
        moved = torch.nonzero(faint).flatten()[: len(chosen)]
        row = torch.arange(len(scene))
        row[moved] = chosen[: len(moved)]
        row = torch.cat([row, chosen[len(moved) :]])
        kept = torch.arange(len(row))
        kept[len(scene) :] = -1
        kept[moved] = -1
        # Those that share their place start with new moments too: the old moments belong to the undivided Gaussian.
        kept[: len(scene)][shared] = -1
        whole = scene.map(lambda tensor: tensor)
        whole.opacity_logits, whole.log_scales = logits, log_scales
        return PopulationChange(whole.map(lambda tensor: tensor[row]), kept)

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> Tensor:
        """Return a draw from each Gaussian's covariance, [G, 3], faded out above the opacity at which it is faint."""
        present = scene.detach()
        fade = torch.sigmoid(_STEEPNESS * (self.transparent - torch.sigmoid(present.opacity_logits)))
        draw = torch.randn(len(scene), 3, generator=generator).to(fade.device) * fade[:, None]
        turn = rotation_matrices(present.quaternions)
        variances = (2 * present.log_scales).exp()
        along_axes = (draw[:, None] @ turn)[:, 0] * variances
        return self.shaking * rate * (turn @ along_axes[..., None])[..., 0]
