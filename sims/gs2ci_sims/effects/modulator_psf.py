"""Modulator PSF: the relay from modulator to sensor blurs the light behind the masks, at least by diffraction."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.effects.kernels import blurred, gaussian_loss, gaussian_tail
from gs2ci_sims.rig import RigFigures

# A kernel with this reach, in standard deviations, counts as complete.
WHOLE_REACH: Final = 8.0


@dataclass(frozen=True)
class ModulatorPsf(EffectRecord):
    """Convolve the light behind the masks with a Gaussian; it is linear, so once for the sum over all masks.

    The relay's own blur and diffraction add in quadrature. The Gaussian nearest to Airy's pattern has a standard
    deviation of 0.42 wavelength x f-number (0.21 wavelength / NA: Zhang, Zerubia and Olivo-Marin, Applied Optics 46
    (2007) 1819), on the scale of the modulator's pitch.

    Args:
        sigma_px: Standard deviation of the relay's aberrations, in sensor pixels, at least 0.
        diffraction: Whether to add diffraction, from the rig's f-number, wavelength and pitch.
        reach: Where the kernel is cut off, in standard deviations; the planner chooses.
    """

    stage: ClassVar[LightStage] = LightStage.PHOTONS
    cost_ns: ClassVar[float] = 60.0

    sigma_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    diffraction: bool = True
    reach: Annotated[float, Field(gt=0, le=10)] = 8.0

    def total_sigma_px(self, rig: RigFigures) -> float:
        """Get the standard deviation of blur and diffraction together, in sensor pixels."""
        spread_um = 0.42e-3 * rig.optics.wavelength_nm * rig.optics.f_number if self.diffraction else 0.0
        return float(np.hypot(self.sigma_px, spread_um * rig.modulator.feature_px / rig.modulator.pitch_um))

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change of the previewed measurement by the blur: one convolution.

        Of the preview's possible error, the blur removes at most the share that it removes of a chequerboard.
        """
        optics, modulator, sigma_px = rig.optics, rig.modulator, self.total_sigma_px(rig)
        taken = float(gaussian_loss(sigma_px, np.array(2**0.5 / np.pi)))
        whole = replace(self, reach=WHOLE_REACH)
        return scene.of_photon_effect(whole, taken).after(
            BoundStep("s", self.sigma_px, "px", "blur of the relay"),
            BoundStep("wave", optics.wavelength_nm if self.diffraction else 0.0, "nm", "wavelength; 0: no diffraction"),
            BoundStep("F", optics.f_number, "", "f-number"),
            BoundStep("el", modulator.feature_px / modulator.pitch_um, "px/um", "sensor pixels per um of modulator"),
            BoundStep("sigma", sigma_px, "px", "blur with diffraction", "hypot(s, 0.42e-3 * wave * F * el)"),
            BoundStep("x", taken, "", "what it takes of a chequerboard", "1 - exp(-4 * sigma**2)"),
        )

    def kernel_bound(self, scene: Previewed, rig: RigFigures, reach: float) -> Bound:
        """The measurement times twice the truncated share of the kernel, in each direction."""
        tail = gaussian_tail(self.total_sigma_px(rig), reach)
        dn = 4 * tail * rig.dn_per_e
        return Bound(dn * scene.light_rms_e, dn * float(scene.most_e.max()))

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Blur the photons [H, W, C]."""
        return blurred(signal, self.total_sigma_px(rig), self.reach)
