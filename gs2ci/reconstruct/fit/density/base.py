"""The interface of density rules, which decide where Gaussians are added and removed.

Here: the statistics on which rules decide, the change they return, a rule applied to some Gaussians only, and the
operations that rules share (duplicate, split).
Not here: any rule, each of which has its own file (`osgr`, `adc`, `revised`, `mcmc`); the criteria that the first three
share (`classic.py`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, Protocol, runtime_checkable

import torch
from torch import Tensor

from gs2ci.render.gaussians import Gaussians, joined, rotation_matrices, transmittance_preserving_opacity

SPLIT_SHRINK = 1.6  # children of a split are smaller by this factor (Kerbl et al. 2023, section 5.2)

Preserving = Literal["both", "duplicates", "neither"]
"""Which operations preserve the transmittance: duplicates and splits, duplicates only, or neither."""


@dataclass(frozen=True)
class GaussianStatistics:
    """Statistics since the rule was last applied.

    Args:
        screen_gradient: Norm of the gradient of the loss by each Gaussian's position on the screen, mean over the
            renderings that show it, [G], in half image sizes (`gs2ci.render.screen`).
        screen_radius: Largest radius seen, [G], as a share of the longer side of the image.
        blended_error: Looks up each Gaussian's part in the present error: its blending weights times the error of
            the pixels, summed over a view, in the view where that is largest, [G]. Costs a rendering.
        extent: The diameter of the camera path, in scene units: the unit in which sizes are judged.
        cap: The largest population allowed.
        iteration: How many iterations are done.
    """

    screen_gradient: Tensor
    screen_radius: Tensor
    blended_error: Callable[[], Tensor]
    extent: float
    cap: int
    iteration: int

    def among(self, rows: Tensor) -> "GaussianStatistics":
        """Return the statistics of some of the Gaussians, [G] bool; the others count towards the cap."""
        return replace(
            self,
            screen_gradient=self.screen_gradient[rows],
            screen_radius=self.screen_radius[rows],
            blended_error=lambda: self.blended_error()[rows],
            cap=self.cap - int((~rows).sum()),
        )


@dataclass(frozen=True)
class PopulationChange:
    """The change that a rule returns.

    Args:
        scene: The new Gaussians.
        source: For each the index of the old one that it continues, or -1, [G'] int64.
        forget: Names of the parameters whose moments the optimiser resets.
    """

    scene: Gaussians
    source: Tensor
    forget: frozenset[str] = frozenset()


@runtime_checkable
class DensityRule(Protocol):
    """Decides where Gaussians are added and removed, and whether they are shaken in between."""

    @property
    def name(self) -> str:
        """Get its name in settings and reports."""

    def change(self, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator) -> PopulationChange:
        """Return the Gaussians with which the fit continues."""

    def shake(self, scene: Gaussians, rate: float, generator: torch.Generator) -> Tensor | None:
        """Return by how much to move the means after an iteration, [G, 3]; None for not at all.

        Args:
            scene: The present Gaussians.
            rate: The means' present step size, in scene units.
            generator: For draws.
        """


def change_among(
    rule: DensityRule, rows: Tensor, scene: Gaussians, evidence: GaussianStatistics, generator: torch.Generator
) -> PopulationChange:
    """Apply a rule to some of the Gaussians, [G] bool, as if there were no others; the others stay as they are.

    Returns:
        Those that the rule returns, then the others.
    """
    present = scene.detach()
    inside, others = torch.nonzero(rows).flatten(), torch.nonzero(~rows).flatten()
    change = rule.change(present.map(lambda tensor: tensor[inside]), evidence.among(rows), generator)
    source = torch.where(change.source < 0, -1, inside[change.source])
    whole = joined([change.scene, present.map(lambda tensor: tensor[others])])
    return PopulationChange(whole, torch.cat([source, others]), change.forget)


def grow(
    scene: Gaussians,
    keep: Tensor,
    duplicate: Tensor,
    split: Tensor,
    generator: torch.Generator,
    *,
    preserving: Preserving = "both",
) -> PopulationChange:
    """Duplicate and split Gaussians, by default without changing what a ray sees through them.

    To preserve the transmittance, both copies or children get the opacity 1 − √(1 − α), so that the two in a row
    transmit as much as the one did (Rota Bulò et al. 2024 for duplicates; the paper extends it to splits, section
    IV-A). Otherwise they keep the opacity of the one (Kerbl et al. 2023).

    Args:
        scene: The present Gaussians, G.
        keep: Those that stay as they are (duplicates among them), [G] bool.
        duplicate: Those that get a copy, [G] bool, a part of `keep`.
        split: Those replaced by two smaller children drawn from their own density, [G] bool, apart from `keep`.
        generator: For the children's places.
        preserving: Which of them preserve the transmittance.

    Returns:
        The kept, then the copies, then the children.
    """
    present = scene.detach()
    halved = transmittance_preserving_opacity(present.opacity_logits)
    revised = present.map(lambda tensor: tensor.clone())
    if preserving != "neither":
        revised.opacity_logits = torch.where(duplicate, halved, present.opacity_logits)
    kept = torch.nonzero(keep).flatten()
    copied = torch.nonzero(duplicate).flatten()
    parents = torch.nonzero(split).flatten().repeat(2)
    children = present.map(lambda tensor: tensor[parents])
    noise = torch.randn(len(parents), 3, generator=generator) * children.log_scales.exp()
    turned = (rotation_matrices(children.quaternions) @ noise[..., None])[..., 0]
    children.means = children.means + turned
    children.log_scales = children.log_scales - math.log(SPLIT_SHRINK)
    if preserving == "both":
        children.opacity_logits = halved[parents]
    parts = (revised.map(lambda tensor: tensor[kept]), revised.map(lambda tensor: tensor[copied]), children)
    newcomers = torch.full((len(copied) + len(parents),), -1, dtype=torch.int64)
    return PopulationChange(joined(parts), torch.cat([kept, newcomers]))


def within(room: int, priority: Tensor, split: Tensor, duplicate: Tensor) -> tuple[Tensor, Tensor]:
    """Keep at most `room` additions, those of the highest priority; each adds one to the population.

    Args:
        room: How many more Gaussians there may be; none if negative.
        priority: [G].
        split: Candidates, [G] bool.
        duplicate: Further candidates, [G] bool.

    Returns:
        Those of the first and those of the second that are kept.
    """
    candidates = torch.nonzero(split | duplicate).flatten()
    if len(candidates) <= room:
        return split, duplicate
    allowed = torch.zeros_like(split)
    if room > 0:
        allowed[candidates[torch.topk(priority[candidates], room).indices]] = True
    return split & allowed, duplicate & allowed
