"""Defocus: points off the plane of focus are spread over a disc, by their depth."""

from dataclasses import dataclass
from typing import ClassVar, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, Previewed, Stage, ViewPreview
from gs2ci_sims.effects.kernels import disc, disc_transfer
from gs2ci_sims.rig import Rig
from gs2ci_sims.signals import View

# Step between the diameters for which the view is blurred; between them the blurred views are interpolated.
LAYER_STEP_PX: Final = 0.5
DIAMETER_MAX_PX: Final = 64.0


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

    stage: ClassVar[Stage] = Stage.RADIANCE
    cost_ns: ClassVar[float] = 400.0
    needs_depth: ClassVar[bool] = True

    aperture: NotNegative
    focus_depth: Positive

    def diameter_px(self, depth: F64, focal_px: float) -> F64:
        """Get the disc's diameter for depths z in scene units; 0 where nothing is."""
        safe = np.where(np.isfinite(depth) & (depth > 0), depth, self.focus_depth)
        diameter = focal_px * self.aperture * np.abs(1 / safe - 1 / self.focus_depth)
        return np.asarray(np.minimum(diameter, DIAMETER_MAX_PX))

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """The spectrum times the loss of each cosine by the widest disc, 1 - 2 J1(x)/x."""
        focal_px, (near, far) = float(scene.scene.intrinsics[0, 0]), scene.scene.depth_range()
        widest = float(self._widest_px(scene.scene.intrinsics, np.array([near, far])).max())
        return scene.of_views(*self.view_change(scene)).after(
            BoundStep("A", self.aperture, "units", "diameter of the aperture"),
            BoundStep("zf", self.focus_depth, "units", "depth in focus"),
            BoundStep("f", focal_px, "px", "focal length"),
            BoundStep("z1", near, "units", "nearest depth (1 % of the pixels are nearer)"),
            BoundStep("z2", far, "units", "farthest depth (1 % are farther)"),
            BoundStep(
                "d",
                widest,
                "px",
                "widest disc; of a cosine of frequency k it takes 1 - 2 J1(pi d k) / (pi d k)",
                f"min({DIAMETER_MAX_PX}, f * A * max(abs(1 / z1 - 1 / zf), abs(1 / z2 - 1 / zf)))",
            ),
        )

    def view_change(self, scene: ViewPreview) -> tuple[float, float]:
        """Return rms and peak of the change of a view by the blur."""
        widest = float(self._widest_px(scene.scene.intrinsics, np.array(scene.scene.depth_range())).max())
        return scene.filtered(lambda f: np.abs(1 - disc_transfer(widest, f)))

    def _widest_px(self, intrinsics: F64, depths: F64) -> F64:
        return self.diameter_px(depths, float(intrinsics[0, 0]))

    def margin_px(self, rig: Rig, size: tuple[int, int], intrinsics: F64) -> int:
        """Half of the widest disc there can be, that of infinity or of half the focus depth."""
        widest = self.diameter_px(np.array([0.5 * self.focus_depth, 1e12]), float(intrinsics[0, 0])).max()
        return int(min(np.ceil(0.5 * widest), max(size)))

    def apply(self, signal: View, rig: Rig, rng: np.random.Generator) -> View:
        """Blur the view by layers of disc diameter."""
        assert signal.depth is not None, "the exposure renders depth for effects that need it"
        diameter = self.diameter_px(signal.depth, float(signal.intrinsics[0, 0]))
        # A disc of less than a pixel changes nothing; for larger ones there is a layer for each step.
        layer = np.maximum(diameter - 1.0, 0.0) / LAYER_STEP_PX
        result = np.zeros_like(signal.radiance)
        for number in np.unique(np.concatenate([np.floor(layer), np.ceil(layer)]).astype(int)):
            share = np.maximum(1 - np.abs(layer - number), 0.0)
            kernel = disc(1.0 + number * LAYER_STEP_PX)
            image = cv2.filter2D(signal.radiance, cv2.CV_64F, kernel, borderType=cv2.BORDER_REFLECT)
            result += share[..., None] * image.reshape(result.shape)
        return View(result, signal.intrinsics, signal.margin, signal.depth)
