"""OSGR: opacity-guided splitting and growth regulation (paper, section III-E and supplement II).

Here: the rule. Its mean-opacity term is in the loss (`losses/objective.py`), its transmittance-preserving opacities in
`base.grow`, the criteria it adds to in `classic.py`, its population cap in the schedule (`fit/coarse/stage.py`).
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange, Preserving, grow, within
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class Osgr:
    """Split Gaussians that are large with a high gradient, or whose opacity exceeds that of their neighbours.

    Args:
        criteria: Thresholds of the conventional criteria, and the reset of opacities.
        opacity_splits: Whether opacity alone may cause a split.
        neighbours: Nearest neighbours whose opacities its own is compared with (supplement II: three).
        extra_splits: Budget for splits by opacity alone, as a share of the population (supplement II: 5 %).
        ranked_first: Whether all Gaussians are ranked by opacity before the conventional candidates are added, as in
            supplement II, so that candidates of both criteria count once. If not, the budget is only for those that no
            other criterion selects.
        shared_room: Whether a population near its cap divides the remaining room among the kinds of candidates by their
            numbers. If not, those with the largest gradient come first, and those selected only by their opacity or
            their radius get no room.
        preserving: Which operations preserve the transmittance (supplement II: copies and children).
    """

    criteria: Classic = field(default_factory=Classic)
    opacity_splits: bool = True
    neighbours: int = 3
    extra_splits: float = 0.05
    ranked_first: bool = False
    shared_room: bool = False
    preserving: Preserving = "both"
    name: str = "osgr"

    @classmethod
    def of_the_paper(cls) -> "Osgr":
        """Return the rule as in the paper, with nerfstudio's thresholds."""
        return cls(criteria=Classic.of_nerfstudio(), ranked_first=True, shared_room=True)

    @classmethod
    def sparing(cls) -> "Osgr":
        """Return the rule with criteria for a fit of about a thousand iterations to one noisy measurement.

        There, splits by radius alone fill smooth regions with Gaussians that fit noise. Without them, and with gsplat's
        threshold for gradients whose norms are summed, half as many Gaussians reproduce the renderings of a fitted
        Gaussian scene better by 0.4 to 0.5 dB and simulated scenes worse by 0.2 to 0.6 dB
        (docs/decisions/several-fits.md has the figures and the data).
        """
        return cls(criteria=Classic(gradient=8e-4, large_on_screen=None))

    @classmethod
    def generous(cls) -> "Osgr":
        """Return the sparing rule with splits by radius: its errors differ, which helps the mean of several fits."""
        return cls(criteria=Classic(gradient=8e-4))

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the population that the fit goes on with."""
        if self.criteria.is_paused(evidence):
            unchanged = PopulationChange(scene.detach().map(torch.clone), torch.arange(len(scene)))
            return self.criteria.reset(unchanged, evidence)
        remove = self.criteria.removed(scene, evidence)
        wanting = self.criteria.wanting(evidence)
        split, duplicate = self.criteria.divide(scene, evidence, wanting)
        excess = self._excess(scene) if self.opacity_splits else torch.zeros(len(scene))
        # Duplication is unchanged: a Gaussian that gets a copy is not split as well.
        peaks = self._peaks(excess, exclude=None if self.ranked_first else split | duplicate) & ~(split | duplicate)
        split, duplicate = (split | peaks) & ~remove, duplicate & ~remove
        room = evidence.cap - (len(scene) - int(remove.sum()))
        priority = evidence.screen_gradient
        if self.shared_room:
            priority = _fair(
                (wanting, evidence.screen_gradient), (peaks, excess), (split | duplicate, evidence.screen_radius)
            )
        split, duplicate = within(room, priority, split, duplicate)
        grown = grow(scene, ~(remove | split), duplicate, split, generator, preserving=self.preserving)
        return self.criteria.reset(grown, evidence)

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> None:
        """Move nothing."""

    def _excess(self, scene: Gaussians) -> Tensor:
        """Return by how much each opacity exceeds its local mean, [G] (paper, eq. 13); zeros for too few Gaussians."""
        opacity, count = torch.sigmoid(scene.opacity_logits.detach()), len(scene)
        if count <= self.neighbours:
            return torch.zeros(count)
        means = scene.means.detach().numpy()
        nearest = cKDTree(means).query(means, k=self.neighbours + 1)[1]
        # Among points in the same place the tree may list any one first. Move each point's own index to the front, so
        # that it can be left out.
        itself_first = np.argsort(nearest != np.arange(count)[:, None], axis=1, kind="stable")
        nearest = np.take_along_axis(nearest, itself_first, axis=1)
        others = opacity[torch.from_numpy(nearest[:, 1:])].sum(dim=1)
        return opacity - (others + opacity) / (self.neighbours + 1)

    def _peaks(self, excess: Tensor, exclude: Tensor | None) -> Tensor:
        """Return those with the largest positive excesses, [G] bool, within budget and without the excluded ones."""
        peaks = torch.zeros(len(excess), dtype=torch.bool)
        budget = int(self.extra_splits * len(excess))
        if budget == 0:
            return peaks
        if exclude is not None:
            excess = torch.where(exclude, 0.0, excess)
        chosen = torch.topk(excess, budget).indices
        peaks[chosen] = excess[chosen] > 0
        return peaks


def _fair(*kinds: tuple[Tensor, Tensor]) -> Tensor:
    """Return priorities, [G], such that any number of the first contains each kind in the proportion of the whole.

    Args:
        kinds: Members of each kind, [G] bool, and their ranking, [G]; a member of several kinds counts for the first.
    """
    priority = torch.zeros(len(kinds[0][0]))
    left = torch.ones(len(priority), dtype=torch.bool)
    for among, measure in kinds:
        members = torch.nonzero(among & left).flatten()
        left[members] = False
        rank = torch.empty(len(members))
        rank[torch.argsort(measure[members], stable=True)] = torch.arange(len(members)) + 0.5
        priority[members] = rank / max(len(members), 1)
    return priority
