"""Finite contrast: a closed element still lets some light through, unevenly over the modulator."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import gaussian_filter

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class FiniteContrast(EffectRecord):
    """Raise the off level of the masks to a map of leakage: M becomes leak + (1 - leak) M.

    The leakage is log-normal over the field, a fixed pattern of the device. Measured masks of two laboratory
    systems have a median off level of 0.040 and 0.042, 0.017 to 0.083 from the 10th to the 90th percentile: a
    contrast of 25 with a spread of ln(0.083 / 0.017) / 2.56 = 0.62.

    Args:
        contrast: On over off, median over the field, more than 1.
        spread: Standard deviation of the leakage's logarithm, 0 to 2.
        patch_px: Scale over which the leakage varies, pixels, at least 0.
    """

    stage: ClassVar[LightStage] = LightStage.MASKS
    cost_ns: ClassVar[float] = 10.0
    fixed_pattern: ClassVar[bool] = True

    contrast: Annotated[float, Field(gt=1)] = 25.0
    spread: Annotated[float, Field(ge=0, le=2)] = 0.62
    patch_px: NotNegative = 4.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The light that passes all closed elements by this device's map of leakage."""
        return scene.of_mask_effect(self).after(
            BoundStep("C", self.contrast, "", "contrast, median over the field"),
            BoundStep("leak", 1 / self.contrast, "", "off level there; a mask M becomes leak + (1 - leak) M", "1 / C"),
            BoundStep("spread", self.spread, "", "standard deviation of its logarithm over the field"),
        )

    def leakage(self, size: tuple[int, int], rng: np.random.Generator) -> F64:
        """Draw the device's map of off levels, [H, W] in [0, 1]."""
        pattern = gaussian_filter(rng.standard_normal(size), self.patch_px, mode="wrap")
        deviation = float(pattern.std())
        pattern = (pattern - pattern.mean()) / deviation if deviation > 0 else np.zeros(size)
        return np.minimum(np.exp(self.spread * pattern) / self.contrast, 1.0)

    def apply(self, signal: NDArray[np.floating], rig: RigFigures, rng: np.random.Generator) -> F64:
        """Raise the off level of masks [N, H, W]."""
        leak = self.leakage((signal.shape[1], signal.shape[2]), rng)
        return leak + (1 - leak) * signal.astype(np.float64)
