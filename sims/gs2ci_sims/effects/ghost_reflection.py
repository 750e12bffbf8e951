"""Ghost reflection: light reflected by the sensor returns from a window, inverted and out of focus."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import cv2
import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.effects.kernels import disc
from gs2ci_sims.rig import RigFigures

MOST_BLUR_PX: Final = 256.0


@dataclass(frozen=True)
class GhostReflection(EffectRecord):
    """Add a share of the image, turned by half a turn about the middle of the sensor and spread over a disc.

    Light reflected twice, by the sensor and by a surface in front of it, forms a ghost; its share is the product of
    both reflectivities (Hullin, Eisemann, Seidel and Lee, ACM Trans. Graphics 30 (2011) 108). By Fresnel's law an
    uncoated surface of index n reflects ((n - 1) / (n + 1))^2, 4.3 % for glass of 1.52. A ghost between the sensor and
    the lens that forms the image is turned about the axis. The image keeps all of its own light here.

    Args:
        share: Share of the light in the ghost, 0 to 0.5.
        blur_px: Diameter of the disc that a point of the ghost is spread over, sensor pixels, 0 to 256.
    """

    stage: ClassVar[LightStage] = LightStage.PHOTONS
    cost_ns: ClassVar[float] = 100.0

    share: Annotated[float, Field(ge=0, le=0.5)]
    blur_px: Annotated[float, Field(ge=0, le=MOST_BLUR_PX)] = 0.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The ghost of the previewed measurement, plus its share of the preview's possible error.

        Neither the rotation nor the blur increases an image's rms.
        """
        return scene.of_photon_effect(self, self.share).after(
            BoundStep("s", self.share, "", "share of the light in the ghost"),
            BoundStep("d", self.blur_px, "px", "diameter of the disc over which the ghost is spread"),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """The image and its ghost."""
        return 1 + self.share

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add the ghost to photons [H, W, C]; beyond the border the image is mirrored."""
        turned = np.ascontiguousarray(signal[::-1, ::-1])
        spread = cv2.filter2D(turned, cv2.CV_64F, disc(self.blur_px), borderType=cv2.BORDER_REFLECT)
        return signal + self.share * spread.reshape(signal.shape)
