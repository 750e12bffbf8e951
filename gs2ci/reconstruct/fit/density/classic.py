"""The criteria of adaptive density control that `adc`, `revised` and `osgr` share (Kerbl et al. 2023, section 5.2).

Here: which Gaussians are to be split or duplicated, which of them are split, which are removed, and the reset of
opacities. Not here: the rules that put them together.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics, PopulationChange
from gs2ci.render.gaussians import Gaussians, logit


@dataclass(frozen=True)
class Classic:
    """Thresholds of the original, with the default values of gsplat and Nerfstudio's trainer.

    Args:
        gradient: Screen gradient above which a Gaussian is split or duplicated.
        large: Size above which it is split rather than duplicated, in units of the camera path's diameter.
        large_on_screen: Radius above which it is split whatever its gradient, as a share of the longer image side;
            None: never (gsplat's default; Nerfstudio has 0.05).
        transparent: Opacity below which it is removed.
        huge: Size above which it is removed, in units of the path's diameter or of the median depth, whichever is
            longer: the original's unit is the size of a scene that cameras surround, which a short path does not show.
        huge_on_screen: Radius above which it is removed, as a share of the longer image side.
        screen_until: Iteration from which on radii no longer count.
        reset_every: Iterations between resets of all opacities; None: never. Sizes remove nothing before the first.
        reset_to: Largest opacity after a reset: twice that of removal, so that needed Gaussians can recover.
        pause_after_reset: Iterations after a reset in which nothing is added or removed: neither opacities nor
            gradients are meaningful until opacities have recovered.
    """

    gradient: float = 2e-4
    large: float = 0.01
    large_on_screen: float | None = 0.05
    transparent: float = 0.005
    huge: float = 0.1
    huge_on_screen: float = 0.15
    screen_until: int = 4000
    reset_every: int | None = 3000
    reset_to: float = 0.01
    pause_after_reset: int = 0

    @classmethod
    def of_nerfstudio(cls) -> "Classic":
        """Return the thresholds of nerfstudio's trainer, on which the paper builds (splatfacto 1.1).

        They differ from the original's in that Gaussians are removed below an opacity of 0.1, not of 0.005, and that
        a reset is followed by a pause. Its gradient threshold, 8e-4, is for norms of absolute gradients; here the
        threshold is 2e-4, which gsplat gives for plain gradients. `huge` stays in this project's unit.
        """
        return cls(transparent=0.1, reset_to=0.2, pause_after_reset=101)

    def is_paused(self, evidence: GaussianStatistics) -> bool:
        """Tell whether the last reset is too recent for anything to be added or removed."""
        if not self.reset_every or evidence.iteration < self.reset_every:
            return False
        return evidence.iteration % self.reset_every < self.pause_after_reset

    def wanting(self, evidence: GaussianStatistics) -> Tensor:
        """Return those whose screen gradient is above the threshold, [G] bool."""
        return evidence.screen_gradient > self.gradient

    def divide(self, scene: Gaussians, evidence: GaussianStatistics, wanting: Tensor) -> tuple[Tensor, Tensor]:
        """Divide Gaussians that need more detail into splits and duplicates, [G] bool each.

        The splits include those whose radius alone is above its threshold.
        """
        split = wanting & (_sizes(scene) > self.large * evidence.extent)
        duplicate = wanting & ~split
        if self.large_on_screen is not None and evidence.iteration < self.screen_until:
            wide = evidence.screen_radius > self.large_on_screen
            split, duplicate = split | wide, duplicate & ~wide
        return split, duplicate

    def removed(self, scene: Gaussians, evidence: GaussianStatistics) -> Tensor:
        """Return those to be removed, [G] bool; none if it would be all, as an empty scene cannot grow again."""
        remove = torch.sigmoid(scene.opacity_logits.detach()) < self.transparent
        if self.reset_every is not None and evidence.iteration > self.reset_every:
            remove = remove | (_sizes(scene) > self.huge * max(evidence.extent, 1.0))
            if evidence.iteration < self.screen_until:
                remove = remove | (evidence.screen_radius > self.huge_on_screen)
        return torch.zeros_like(remove) if bool(remove.all()) else remove

    def reset(self, change: PopulationChange, evidence: GaussianStatistics) -> PopulationChange:
        """Bound all opacities if a reset is due; the optimiser then resets their moments."""
        if not self.reset_every or evidence.iteration == 0 or evidence.iteration % self.reset_every:
            return change
        scene = change.scene.map(lambda tensor: tensor)
        scene.opacity_logits = scene.opacity_logits.clamp(max=float(logit(torch.tensor(self.reset_to))))
        return replace(change, scene=scene, forget=change.forget | {"opacity_logits"})


def _sizes(scene: Gaussians) -> Tensor:
    """Return each Gaussian's longest standard deviation, [G]."""
    return scene.log_scales.detach().exp().amax(dim=1)
