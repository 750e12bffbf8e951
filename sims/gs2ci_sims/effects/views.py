"""Effects on views: what the optics make of light on its way to the modulator.

- Vignetting: the image is darker towards its edges.
- Optics PSF: the lens spreads each point of the scene a little.
- Defocus: points off the plane of focus are spread over a disc, by their depth.
- Lens distortion: straight lines are bent towards the border.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, Final

import cv2
import numpy as np
from pydantic import Field, FiniteFloat
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative, Positive
from gs2ci.core.errors import InputError
from gs2ci.core.lens import pixel_centres, pixels_of, slopes_of
from gs2ci.render.sampling import CanvasSampling
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, MotionPreview, Previewed
from gs2ci_sims.effects.kernels import (
    blurred,
    blurred_inside,
    disc,
    gaussian_loss,
    gaussian_radius,
    gaussian_tail,
    shift_shares,
)
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

    stage = LightStage.RADIANCE
    cost_ns = 20.0

    exponent: NotNegative = 4.0

    def transmission(self, size: tuple[int, int], intrinsics: F64) -> F64:
        """Get the factor of each pixel, [H, W] in (0, 1]."""
        square = np.square(slopes_of(pixel_centres(size), intrinsics)).sum(axis=-1)
        return (1 + square) ** (-0.5 * self.exponent)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The share of its reading that each pixel loses, under whichever masks are the more open."""
        lost = 1 - self.transmission(scene.scene.size, scene.scene.intrinsics)
        return scene.of_masks(self, lost * scene.most_open).after(
            BoundStep("n", self.exponent, "", "light falls as cos^n of the field angle"),
            BoundStep("c", float(lost.max()), "", "share lost in the farthest corner"),
        )

    def apply(self, signal: View, rig: RigFigures, rng: Rng) -> View:
        """Darken the view."""
        factor = self.transmission(signal.radiance.shape[:2], signal.intrinsics)
        return View(signal.radiance * factor[..., None], signal.intrinsics, signal.margin, signal.depth)


@dataclass(frozen=True)
class OpticsPsf(EffectRecord):
    """Convolve each view with a Gaussian: a lens whose many small errors add up (aberrations, focus, diffraction).

    Its MTF is exp(-2 (pi sigma f)^2) (Boreman, Modulation Transfer Function in Optical Systems, section 1.2).

    Args:
        sigma_px: Standard deviation in sensor pixels, at least 0.
        reach: Where the kernel is cut off, in standard deviations; the planner chooses.
    """

    stage = LightStage.RADIANCE
    cost_ns = 60.0
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

    def apply(self, signal: View, rig: RigFigures, rng: Rng) -> View:
        """Blur the view."""
        image = blurred(signal.radiance, self.sigma_px, self.reach)
        return View(image, signal.intrinsics, signal.margin, signal.depth)


# Step between the diameters for which the view is blurred; between them the blurred views are interpolated.
LAYER_STEP_PX: Final = 0.5
DIAMETER_MAX_PX: Final = 64.0
# The discs as drawn, of every diameter up to that one, take no more than this of any cosine: they turn some over.
MOST_TAKEN: Final = 1.17
# Moments at which a bound asks where the camera is, and the depth, scene units, that counts for what it flies through.
MOMENTS: Final = 17
NEAREST: Final = 1e-6


@dataclass(frozen=True)
class Defocus(EffectRecord):
    """Blur each pixel by the disc that belongs to its depth.

    A thin lens with an aperture of diameter A, focused at z_f, spreads a point at z over a disc of diameter
    f A |1/z - 1/z_f| in pixels, f the focal length in pixels (Pentland, IEEE PAMI 9 (1987) 523, for an image plane
    much nearer than z_f). Each pixel gathers with its own disc: at the rim of a near, blurred object the sharp
    background does not show through it.

    Args:
        aperture: Diameter in scene units, at least 0.
        focus_depth: z of what is sharp, scene units, more than 0.
    """

    stage = LightStage.RADIANCE
    cost_ns = 400.0
    needs_depth: ClassVar[bool] = True

    aperture: NotNegative
    focus_depth: Positive

    def diameter_px(self, depth: F64, focal_px: float) -> F64:
        """Get the disc's diameter for depths z in scene units; 0 where nothing is."""
        safe = np.where(np.isfinite(depth) & (depth > 0), depth, self.focus_depth)
        diameter = focal_px * self.aperture * np.abs(1 / safe - 1 / self.focus_depth)
        return np.minimum(diameter, DIAMETER_MAX_PX)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change of the previewed views by the disc that changes each pixel most; of other light, the spectrum."""
        focal_px, (near, far) = float(scene.scene.intrinsics[0, 0]), _depths(scene)
        widest = self._widest_px(scene)
        return scene.of_views(*scene.view_change(self)).after(
            BoundStep("A", self.aperture, "units", "diameter of the aperture"),
            BoundStep("zf", self.focus_depth, "units", "depth in focus"),
            BoundStep("f", focal_px, "px", "focal length"),
            BoundStep("z1", near, "units", "nearest depth on the way of the camera"),
            BoundStep("z2", far, "units", "farthest depth"),
            BoundStep(
                "d",
                widest,
                "px",
                "widest disc; it and all narrower ones take of a cosine of frequency k at most 2 (pi k s)^2, s its "
                "standard deviation along an axis",
                f"min({DIAMETER_MAX_PX}, f * A * max(abs(1 / z1 - 1 / zf), abs(1 / z2 - 1 / zf)))",
            ),
        )

    def view_change(self, scene: MotionPreview) -> tuple[float, float]:
        """Return rms and peak of the change of a view by the blur.

        A wider disc may take less of a cosine than a narrower one, and depths may lie so that each pixel has the disc
        that changes it most. Of a cosine of frequency k, a kernel of variance s^2 along it takes the mean of
        1 - cos(2 pi k x), at most 2 (pi k s)^2.
        """
        layers = range(1, int(np.ceil(_layer(np.array(self._widest_px(scene))))) + 1)
        kernel = _kernel(layers.stop - 1)
        place = np.arange(len(kernel)) - len(kernel) // 2
        variance = float(kernel.sum(axis=1) @ place**2)

        def most(view: View) -> F64:
            changes = [np.abs(_blurred(view.radiance, layer) - view.radiance) for layer in layers]
            return view.inner(np.asarray(np.max(changes, axis=0)) if changes else np.zeros_like(view.radiance))

        return scene.changed(self, most, lambda f: np.minimum(2 * variance * np.square(np.pi * f), MOST_TAKEN))

    def _widest_px(self, scene: MotionPreview) -> float:
        return float(self.diameter_px(np.array(_depths(scene)), float(scene.scene.intrinsics[0, 0])).max())

    def margin_px(self, rig: RigFigures, size: tuple[int, int], intrinsics: F64) -> int:
        """Half of the widest disc there can be, that of infinity or of half the focus depth."""
        widest = self.diameter_px(np.array([0.5 * self.focus_depth, 1e12]), float(intrinsics[0, 0])).max()
        return int(min(np.ceil(0.5 * widest), max(size)))

    def apply(self, signal: View, rig: RigFigures, rng: Rng) -> View:
        """Blur the view by layers of disc diameter."""
        assert signal.depth is not None, "the exposure renders depth for effects that need it"
        diameter = self.diameter_px(signal.depth, float(signal.intrinsics[0, 0]))
        layer = _layer(diameter)
        result = np.zeros_like(signal.radiance)
        for number in np.unique(np.concatenate([np.floor(layer), np.ceil(layer)]).astype(int)):
            share = np.maximum(1 - np.abs(layer - number), 0.0)
            result += share[..., None] * _blurred(signal.radiance, int(number))
        return View(result, signal.intrinsics, signal.margin, signal.depth)


def _depths(scene: MotionPreview) -> tuple[float, float]:
    """Return the nearest and the farthest depth of all pixels while the camera moves along its axis, scene units."""
    times_s = np.linspace(scene.intervals_s[0, 0], scene.intervals_s[-1, 1], MOMENTS)
    nearer = (scene.path.world_to_camera(times_s) @ np.linalg.inv(scene.scene.world_to_camera))[:, 2, 3]
    depth = scene.scene.depth[scene.scene.depth > 0]
    near, far = float(depth.min() + min(nearer.min(), 0.0)), float(depth.max() + max(nearer.max(), 0.0))
    return max(near, NEAREST), far


def _layer(diameter_px: F64) -> F64:
    """Return which layers discs lie between: none of less than a pixel, which change nothing, one for each step."""
    return np.maximum(diameter_px - 1.0, 0.0) / LAYER_STEP_PX


def _kernel(layer: int) -> F64:
    return disc(1.0 + layer * LAYER_STEP_PX)


def _blurred(radiance: F64, layer: int) -> F64:
    """Blur radiance [H, W, C] by a layer's disc."""
    image = cv2.filter2D(radiance, cv2.CV_64F, _kernel(layer), borderType=cv2.BORDER_REFLECT)
    return image.reshape(radiance.shape)


# Newton steps that invert the polynomial: more than enough with quadratic convergence.
INVERSION_STEPS: Final = 20
# Cameras, with and without a margin, of which the places are kept that light comes from: 16 bytes per pixel each.
PLACES_KEPT: Final = 4


@dataclass(frozen=True)
class LensDistortion(EffectRecord):
    """Shift points at radius r from the axis (tangent of the field angle) to r (1 + k1 r^2 + k2 r^4).

    The radial model of Brown (Photogrammetric Engineering 32 (1966) 444), with the signs of OpenCV: k1 < 0 is a
    barrel.

    Args:
        k1: Coefficient of r^2.
        k2: Coefficient of r^4.
    """

    stage = LightStage.RADIANCE
    cost_ns = 600.0
    needs_depth: ClassVar[bool] = False

    k1: FiniteFloat
    k2: FiniteFloat = 0.0

    def undistorted_radius(self, radius: F64) -> F64:
        """Invert r (1 + k1 r^2 + k2 r^4) by Newton's method.

        Raises:
            InputError: The polynomial is not monotonic within these radii: it maps two field angles to one place.
        """
        bare = np.array(radius, dtype=np.float64)
        for _ in range(INVERSION_STEPS):
            square = np.square(bare)
            slope = 1 + 3 * self.k1 * square + 5 * self.k2 * np.square(square)
            if not (slope > 0.05).all():
                raise InputError(
                    f"distortion k1 = {self.k1}, k2 = {self.k2} folds the image over at radius {bare.max():.3g}",
                    remedy="use smaller coefficients or a narrower field of view",
                )
            bare -= (bare * (1 + self.k1 * square + self.k2 * np.square(square)) - radius) / slope
        return bare

    def sources_px(self, size: tuple[int, int], intrinsics: F64) -> F64:
        """Return where each pixel's light would fall without distortion: rows and columns, [2, H, W], centres +0.5."""
        return _sources_px(self, (int(size[0]), int(size[1])), np.asarray(intrinsics, dtype=np.float64).tobytes())

    def sampling(self, size: tuple[int, int], intrinsics: F64) -> CanvasSampling:
        """Return the viewing directions of an image's pixels, for a renderer that accepts them."""
        return CanvasSampling.around(np.moveaxis(self.sources_px(size, intrinsics)[::-1], 0, -1))

    @property
    def coefficients(self) -> F64:
        """Get the coefficients that a perfect calibration would find: OpenCV's k1 k2 p1 p2 k3, [5]."""
        return np.array([self.k1, self.k2, 0.0, 0.0, 0.0])

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The change of the previewed views by the lens; of other light, that by the largest displacement."""
        return scene.of_views(*scene.view_change(self)).after(
            BoundStep("k1", self.k1, "", "r becomes r (1 + k1 r^2 + k2 r^4)"),
            BoundStep("k2", self.k2, "", "as above"),
            BoundStep(
                "d",
                self._most_px(scene),
                "px",
                "largest displacement in the frame; a cosine of frequency k changes by 2 sin(pi k d) at most",
            ),
        )

    def view_change(self, scene: MotionPreview) -> tuple[float, float]:
        """Return rms and peak of the lens's change of a view.

        Of light that is not previewed, the detail may lie where the displacement is largest.
        """
        most_px = self._most_px(scene)
        return scene.changed(
            self,
            lambda view: view.inner(self.bent(view.radiance, view.intrinsics) - view.radiance),
            lambda f: shift_shares(f, most_px),
        )

    def _most_px(self, scene: MotionPreview) -> float:
        moved = self._moved(scene.scene.size, scene.scene.intrinsics)
        return float(np.sqrt(np.square(moved).sum(axis=0).max()))

    def _moved(self, size: tuple[int, int], intrinsics: F64) -> F64:
        return self.sources_px(size, intrinsics) - (np.mgrid[: size[0], : size[1]] + 0.5)

    def margin_px(self, rig: RigFigures, size: tuple[int, int], intrinsics: F64) -> int:
        """Return the largest displacement along an axis, and two pixels for the interpolation."""
        return int(np.ceil(np.abs(self._moved(size, intrinsics)).max())) + 2

    def apply(self, signal: View, rig: RigFigures, rng: Rng) -> View:
        """Resample the view with cubic splines at its light's origin; beyond the margin the border is repeated."""
        return View(self.bent(signal.radiance, signal.intrinsics), signal.intrinsics, signal.margin, signal.depth)

    def bent(self, picture: F64, intrinsics: F64) -> F64:
        """Return a picture, [H, W, C] with its camera matrix [3, 3], as the lens shows it."""
        places = self.sources_px((picture.shape[0], picture.shape[1]), intrinsics) - 0.5
        channels = [map_coordinates(picture[..., c], places, order=3, mode="nearest") for c in range(picture.shape[2])]
        return np.maximum(np.stack(channels, axis=-1), 0)


@lru_cache(maxsize=PLACES_KEPT)
def _sources_px(lens: LensDistortion, size: tuple[int, int], camera: bytes) -> F64:
    """Solve for `LensDistortion.sources_px`; kept, because it is the same for every view. `camera`: float64, [3, 3]."""
    intrinsics = np.frombuffer(camera).reshape(3, 3)
    slopes = slopes_of(pixel_centres(size), intrinsics)
    radius = np.hypot(slopes[..., 0], slopes[..., 1])
    scale = np.where(radius > 0, lens.undistorted_radius(radius) / np.maximum(radius, 1e-12), 1.0)
    columns, rows = np.moveaxis(pixels_of(slopes * scale[..., None], intrinsics), -1, 0)
    places = np.stack([rows, columns])
    places.setflags(write=False)
    return places
