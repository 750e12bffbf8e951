"""Vignetting: the image is darker towards its edges."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View


@dataclass(frozen=True)
class Vignetting(EffectRecord):
    """Multiply by cos^n of the field angle.

    n = 4 is the natural law of a thin lens (Kingslake, Optics in Photography, chapter 7); mechanical vignetting
    makes it steeper.

    Args:
        exponent: n, at least 0.
    """

    stage: ClassVar[LightStage] = LightStage.RADIANCE
    cost_ns: ClassVar[float] = 20.0

    exponent: NotNegative = 4.0

    def transmission(self, size: tuple[int, int], intrinsics: F64) -> F64:
        """Get the factor of each pixel, [H, W] in (0, 1]."""
        rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
        square = np.square((columns - intrinsics[0, 2]) / intrinsics[0, 0])
        square += np.square((rows - intrinsics[1, 2]) / intrinsics[1, 1])
        return (1 + square) ** (-0.5 * self.exponent)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The share of its reading that each pixel loses, under whichever masks are the more open."""
        lost = 1 - self.transmission(scene.scene.size, scene.scene.intrinsics)
        return scene.of_masks(self, lost * scene.most_open).after(
            BoundStep("n", self.exponent, "", "light falls as cos^n of the field angle"),
            BoundStep("c", float(lost.max()), "", "share lost in the farthest corner"),
        )

    def apply(self, signal: View, rig: RigFigures, rng: np.random.Generator) -> View:
        """Darken the view."""
        factor = self.transmission(signal.radiance.shape[:2], signal.intrinsics)
        return View(signal.radiance * factor[..., None], signal.intrinsics, signal.margin, signal.depth)
