"""Lens distortion: straight lines are bent towards the border."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final

import numpy as np
from pydantic import FiniteFloat
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.render.sampling import CanvasSampling
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, MotionPreview, Previewed
from gs2ci_sims.effects.kernels import shift_shares
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.signals import View

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

    stage: ClassVar[LightStage] = LightStage.RADIANCE
    cost_ns: ClassVar[float] = 600.0
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

    def apply(self, signal: View, rig: RigFigures, rng: np.random.Generator) -> View:
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
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    x = (columns - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (rows - intrinsics[1, 2]) / intrinsics[1, 1]
    radius = np.hypot(x, y)
    scale = np.where(radius > 0, lens.undistorted_radius(radius) / np.maximum(radius, 1e-12), 1.0)
    places = np.stack(
        [y * scale * intrinsics[1, 1] + intrinsics[1, 2], x * scale * intrinsics[0, 0] + intrinsics[0, 2]]
    )
    places.setflags(write=False)
    return places
