"""Mask edges: an element's transmission changes gradually at its edge."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.effects.kernels import blurred, gaussian_tail
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class MaskEdges(EffectRecord):
    """Blur the masks themselves by a Gaussian: gaps between mirrors, fringing fields between cells.

    A Gaussian of about 0.5 px fits two measured sets of laboratory masks against their binarised copies.

    Args:
        sigma_px: Standard deviation in sensor pixels, 0 to 100.
        reach: Where the kernel is cut off, in standard deviations; the planner chooses.
    """

    stage: ClassVar[LightStage] = LightStage.MASKS
    cost_ns: ClassVar[float] = 20.0

    sigma_px: Annotated[float, Field(ge=0, le=100)] = 0.5
    reach: Annotated[float, Field(gt=0, le=10)] = 8.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change by the blur of the masks that reach it."""
        sigma = BoundStep("sigma", self.sigma_px, "px", "standard deviation of the blur of the masks")
        return scene.of_mask_effect(self).after(sigma)

    def kernel_bound(self, scene: Previewed, rig: RigFigures, reach: float) -> Bound:
        """The masks' deviation from their mean, times twice the truncated share of the kernel, per direction.

        Each mask's change counts at the brightest light, and changes of different masks do not cancel.
        """
        tail = gaussian_tail(self.sigma_px, reach)
        deviation = float(scene.masks.std(axis=(1, 2), dtype=np.float64).sum())
        light = 4 * tail * scene.full_scale_dn * scene.scene.brightest
        return Bound(light * deviation, light * len(scene.masks))

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: np.random.Generator) -> F64:
        """Blur masks [N, H, W]."""
        return self._blurred(signal, self.reach)

    def _blurred(self, masks: NDArray[np.floating], reach: float) -> F64:
        return np.stack([blurred(mask.astype(np.float64), self.sigma_px, reach) for mask in masks])
