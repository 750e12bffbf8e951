"""Effects on the light behind the modulator; each is linear, so that it acts on the sum over all masks.

- Modulator PSF: the relay from modulator to sensor blurs the light behind the masks, at least by diffraction.
- Ghost reflection: light reflected by the sensor returns from a window, inverted and out of focus.
- Dust: particles on the sensor's cover glass cast shadows that are the same in every exposure.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final

import cv2
import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64, Rng
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview
from gs2ci_sims.effects.kernels import blurred, disc, gaussian_loss, gaussian_tail
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

    stage = LightStage.PHOTONS
    cost_ns = 60.0

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

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Blur the photons [H, W, C]."""
        return blurred(signal, self.total_sigma_px(rig), self.reach)


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

    stage = LightStage.PHOTONS
    cost_ns = 100.0

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

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add the ghost to photons [H, W, C]; beyond the border the image is mirrored."""
        turned = np.ascontiguousarray(signal[::-1, ::-1])
        spread = cv2.filter2D(turned, cv2.CV_64F, disc(self.blur_px), borderType=cv2.BORDER_REFLECT)
        return signal + self.share * spread.reshape(signal.shape)


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

    stage = LightStage.PHOTONS
    cost_ns = 10.0
    fixed_pattern = True

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

    def transmission(self, size: tuple[int, int], rng: Rng) -> F64:
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

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Shade photons [H, W, C]."""
        return signal * self.transmission(signal.shape[:2], rng)[..., None]
