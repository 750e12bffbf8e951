"""Defocus: points off the plane of focus are spread over a disc, by their depth."""

from dataclasses import dataclass
from typing import ClassVar, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, MotionPreview, Previewed
from gs2ci_sims.effects.kernels import disc
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View

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

    stage: ClassVar[LightStage] = LightStage.RADIANCE
    cost_ns: ClassVar[float] = 400.0
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

    def apply(self, signal: View, rig: RigFigures, rng: np.random.Generator) -> View:
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
