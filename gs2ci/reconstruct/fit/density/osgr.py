"""OSGR: opacity-guided splitting and growth regulation (paper, section III-E and supplement II).

Here: the rule. Its mean-opacity term is in the loss (`fit/losses.py`), its transmittance-preserving opacities in
`base.grow`, the criteria it adds to in `classic.py`, its population cap in the schedule (`fit/coarse.py`). For
`gs2ci.reconstruct.fit`.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange, grow, within
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class Osgr:
    """Split where the gradient is high and the Gaussian large, or where its opacity stands out of its neighbours'.

    Args:
        criteria: Thresholds of the conventional criteria, and the reset of opacities.
        opacity_splits: Whether opacity alone may ask for a split.
        neighbours: Nearest neighbours whose opacities its own is compared with (supplement II: three).
        extra_splits: Budget for splits by opacity alone, as a share of the population (supplement II: 5 %).
    """

    criteria: Classic = field(default_factory=Classic)
    opacity_splits: bool = True
    neighbours: int = 3
    extra_splits: float = 0.05
    name: str = "osgr"

    @classmethod
    def sparing(cls) -> "Osgr":
        """Return the rule with criteria for a fit of about a thousand iterations to one noisy measurement.

        There, splits by radius alone fill smooth regions with Gaussians that fit noise. Without them, and with the
        threshold that gsplat gives for gradients whose norms are summed, half as many Gaussians show the
        renderings of a fitted Gaussian scene better by 0.4 to 0.5 dB and simulated scenes worse by 0.2 to 0.6 dB
        (docs/decisions/0016-the-default-splits-less.md has the figures, and on which data they were taken).
        """
        return cls(criteria=Classic(gradient=8e-4, large_on_screen=None))

    @classmethod
    def generous(cls) -> "Osgr":
        """Return the sparing rule with splits by radius: the other way to err, for fits that are averaged."""
        return cls(criteria=Classic(gradient=8e-4))

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the population that the fit goes on with."""
        opacity = torch.sigmoid(scene.opacity_logits.detach())
        remove = self.criteria.removed(scene, evidence)
        split, duplicate = self.criteria.divide(scene, evidence, self.criteria.wanting(evidence))
        if self.opacity_splits:
            split = split | self._opacity_peaks(scene, opacity, exclude=split | duplicate)
        split, duplicate = split & ~remove, duplicate & ~remove
        room = evidence.cap - (len(scene) - int(remove.sum()))
        split, duplicate = within(room, evidence.screen_gradient, split, duplicate)
        return self.criteria.reset(grow(scene, ~(remove | split), duplicate, split, generator), evidence)

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> None:
        """Move nothing."""

    def _opacity_peaks(self, scene: Gaussians, opacity: Tensor, exclude: Tensor) -> Tensor:
        """Return those whose opacity exceeds its local mean (paper, eq. 13), the largest excesses within budget."""
        count = len(scene)
        peaks = torch.zeros(count, dtype=torch.bool)
        budget = int(self.extra_splits * count)
        if budget == 0 or count <= self.neighbours:
            return peaks
        means = scene.means.detach().numpy()
        nearest = np.asarray(cKDTree(means).query(means, k=self.neighbours + 1)[1])
        # Of points in one place the tree lists any first: put each one's own index there, to leave it out.
        itself_first = np.argsort(nearest != np.arange(count)[:, None], axis=1, kind="stable")
        nearest = np.take_along_axis(nearest, itself_first, axis=1)
        others = opacity[torch.from_numpy(nearest[:, 1:])].sum(dim=1)
        excess = opacity - (others + opacity) / (self.neighbours + 1)
        excess[exclude] = 0.0
        chosen = torch.topk(excess, budget).indices
        peaks[chosen] = excess[chosen] > 0
        return peaks
