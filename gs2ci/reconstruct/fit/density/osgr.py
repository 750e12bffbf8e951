"""OSGR: opacity-guided splitting and growth regulation (paper, section III-E and supplement II).

Here: the rule. Its mean-opacity term is in the loss (`fit/losses.py`), its transmittance-preserving opacities in
`base.grow`. For `gs2ci.reconstruct.fit`.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import Change, Evidence, grow
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class Osgr:
    """Split where the gradient is high and the Gaussian large, or where its opacity stands out of its neighbours'.

    Args:
        gradient: Screen gradient above which a Gaussian is split or duplicated (gsplat's default, half widths).
        large: Size above which it is split rather than duplicated, in units of the extent (Kerbl et al. 2023).
        neighbours: Nearest neighbours whose opacities its own is compared with (supplement II: three).
        extra_splits: Budget for splits by opacity alone, as a share of the population (supplement II: 5 %).
        transparent: Opacity below which a Gaussian is removed (Kerbl et al. 2023).
    """

    gradient: float = 2e-4
    large: float = 0.01
    neighbours: int = 3
    extra_splits: float = 0.05
    transparent: float = 0.005
    name: str = "osgr"

    def change(self, scene: Gaussians, evidence: Evidence, generator: torch.Generator) -> Change:
        """Return the population that the fit goes on with."""
        opacity = torch.sigmoid(scene.opacity_logits.detach())
        remove = opacity < self.transparent
        if bool(remove.all()):  # an empty scene cannot grow again: leave the judgement to the held-out pixels
            remove = torch.zeros_like(remove)
        size = scene.log_scales.detach().exp().amax(dim=1)
        wanted = evidence.screen_gradient > self.gradient
        split = wanted & (size > self.large * evidence.extent)
        duplicate = wanted & ~split
        split = split | self._opacity_peaks(scene, opacity, exclude=wanted)
        split, duplicate = split & ~remove, duplicate & ~remove
        room = evidence.cap - (len(scene) - int(remove.sum()))
        split, duplicate = _within(room, evidence.screen_gradient, split, duplicate)
        return grow(scene, ~(remove | split), duplicate, split, generator)

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


def _within(room: int, gradient: Tensor, split: Tensor, duplicate: Tensor) -> tuple[Tensor, Tensor]:
    """Keep at most `room` additions, those with the largest gradients; each adds one to the population."""
    candidates = torch.nonzero(split | duplicate).flatten()
    if len(candidates) <= room:
        return split, duplicate
    allowed = torch.zeros_like(split)
    if room > 0:
        allowed[candidates[torch.topk(gradient[candidates], room).indices]] = True
    return split & allowed, duplicate & allowed
