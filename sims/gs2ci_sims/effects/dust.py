"""Dust: particles on the sensor's cover glass cast shadows that are the same in every exposure."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import cv2
import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.effects.kernels import disc
from gs2ci_sims.rig import RigFigures

MOST_PX: Final = 128.0
MOST_PARTICLES: Final = 10_000


@dataclass(frozen=True)
class Dust(EffectRecord):
    """Multiply the light by what opaque round particles on the cover glass let through, the same in every exposure.

    A pixel sees the aperture of the lens through a cone, which crosses the glass in a disc; it loses the share of that
    disc which a particle covers (Willson, Maimone, Johnson and Scherr, An optical model for image artifacts produced
    by dust particles on lenses, i-SAIRAS 2005). The cone's diameter is the distance of the glass over the f-number on
    the sensor's side, both in air; where cones overlap several particles, what each lets through is multiplied.

    Args:
        particles: Mean number on the glass before the sensor; the number is drawn from Poisson's law, 0 to 10000.
        diameter_px: Diameter of a particle, in sensor pixels, 0 to 128.
        cone_px: Diameter of the cone where it crosses the glass, in sensor pixels, 0 to 128.
    """

    stage: ClassVar[LightStage] = LightStage.PHOTONS
    cost_ns: ClassVar[float] = 10.0
    fixed_pattern: ClassVar[bool] = True

    particles: Annotated[float, Field(ge=0, le=MOST_PARTICLES)]
    diameter_px: Annotated[float, Field(ge=0, le=MOST_PX)]
    cone_px: Annotated[float, Field(ge=0, le=MOST_PX)]

    def shadow(self) -> F64:
        """Return the share of its light that each pixel around a particle loses, [2 r + 1, 2 r + 1] in [0, 1]."""
        area = 0.25 * np.pi * self.diameter_px**2
        particle, cone = disc(self.diameter_px), disc(self.cone_px)
        rim = cone.shape[0] // 2
        covered = cv2.filter2D(np.pad(area * particle, rim), cv2.CV_64F, cone, borderType=cv2.BORDER_CONSTANT)
        return np.minimum(covered, 1.0)

    def transmission(self, size: tuple[int, int], rng: np.random.Generator) -> F64:
        """Draw the transmission of the glass of a sensor of this size, [H, W] in [0, 1]."""
        shadow = self.shadow()
        reach = shadow.shape[0] // 2
        passed = np.ones((size[0] + 2 * reach, size[1] + 2 * reach))
        for _ in range(int(rng.poisson(self.particles))):
            row, column = (int(rng.integers(side)) for side in size)
            passed[row : row + 2 * reach + 1, column : column + 2 * reach + 1] *= 1 - shadow
        return passed[reach : reach + size[0], reach : reach + size[1]]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The loss of the previewed measurement by this device's shadows, plus the preview's possible error in full."""
        deepest = float(self.shadow().max())
        return scene.of_photon_effect(self, 1.0 if self.particles > 0 else 0.0).after(
            BoundStep("n", self.particles, "", "particles, in the mean"),
            BoundStep("D", self.diameter_px, "px", "diameter of a particle"),
            BoundStep("C", self.cone_px, "px", "diameter of the cone of light that a pixel sees, at the glass"),
            BoundStep("s", deepest, "", "deepest shadow of one particle"),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Shade photons [H, W, C]."""
        return signal * self.transmission(signal.shape[:2], rng)[..., None]
