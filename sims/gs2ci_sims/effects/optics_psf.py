"""Optics PSF: the lens spreads each point of the scene a little."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, MotionPreview, Previewed
from gs2ci_sims.effects.kernels import blurred, blurred_inside, gaussian_loss, gaussian_radius, gaussian_tail
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View


@dataclass(frozen=True)
class OpticsPsf(EffectRecord):
    """Convolve each view with a Gaussian: a lens whose many small errors add up (aberrations, focus, diffraction).

    Its MTF is exp(-2 (pi sigma f)^2) (Boreman, Modulation Transfer Function in Optical Systems, section 1.2).

    Args:
        sigma_px: Standard deviation in sensor pixels, at least 0.
        reach: Where the kernel is cut off, in standard deviations; the planner chooses.
    """

    stage: ClassVar[LightStage] = LightStage.RADIANCE
    cost_ns: ClassVar[float] = 60.0
    needs_depth: ClassVar[bool] = False

    sigma_px: Annotated[float, Field(ge=0, le=100)]
    reach: Annotated[float, Field(gt=0, le=10)] = 8.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change of the previewed views by the blur; of the rest of the light, the spectrum times 1 - MTF."""
        sigma = BoundStep(
            "sigma", self.sigma_px, "px", "blur; of a cosine of frequency k it takes 1 - exp(-2 (pi sigma k)^2)"
        )
        return scene.of_views(*scene.view_change(self)).after(sigma)

    def view_change(self, scene: MotionPreview) -> tuple[float, float]:
        """Return rms and peak of the change of a view by the blur."""
        return scene.changed(
            self,
            lambda view: (
                blurred_inside(view.radiance, self.sigma_px, self.reach, view.margin) - view.inner(view.radiance)
            ),
            lambda f: gaussian_loss(self.sigma_px, f),
        )

    def kernel_bound(self, scene: Previewed, rig: RigFigures, reach: float) -> Bound:
        """The view without its mean, times twice the truncated share of the kernel, in each of two directions."""
        share = 4 * gaussian_tail(self.sigma_px, reach)
        rms, peak = scene.deviation
        return scene.of_views(share * rms, share * peak)

    def margin_px(self, rig: RigFigures, size: tuple[int, int], intrinsics: F64) -> int:
        """Return the kernel's radius."""
        return gaussian_radius(self.sigma_px, self.reach)

    def apply(self, signal: View, rig: RigFigures, rng: np.random.Generator) -> View:
        """Blur the view."""
        image = blurred(signal.radiance, self.sigma_px, self.reach)
        return View(image, signal.intrinsics, signal.margin, signal.depth)
