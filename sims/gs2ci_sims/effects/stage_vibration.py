"""Stage vibration: the camera trembles about its path."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.path import CameraPath, highest_hz, kinks_s
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class TremblingPath:
    """A path whose camera is displaced by amplitude sin(2 pi hz t + phases) along its right and down axes."""

    base: CameraPath
    amplitude: float
    hertz: float
    phases: tuple[float, float]

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion."""
        return max(self.hertz, highest_hz(self.base))

    def kinks_s(self, start_s: float, stop_s: float) -> F64:
        """Get when the velocity of the path beneath jumps, [K]."""
        return kinks_s(self.base, start_s, stop_s)

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]: the scene moves against the camera."""
        time = np.asarray(time_s, dtype=np.float64)
        poses = np.array(self.base.world_to_camera(time))
        poses[:, :2, 3] -= self.amplitude * np.sin(2 * np.pi * self.hertz * time[:, None] + np.array(self.phases))
        return poses


@dataclass(frozen=True)
class StageVibration(EffectRecord):
    """Let the camera tremble sinusoidally across the line of sight; the phases of both axes are drawn.

    Args:
        amplitude: Along each axis, scene units, at least 0.
        hertz: More than 0.
    """

    stage: ClassVar[LightStage] = LightStage.MOTION
    cost_ns: ClassVar[float] = 0.1

    amplitude: NotNegative
    hertz: Positive

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What shifting the image of the nearest point by the amplitude along both axes changes."""
        near, focal_px = scene.scene.depth_range()[0], float(scene.scene.intrinsics[:2, :2].max())
        shift_px = 2**0.5 * self.amplitude * focal_px / near
        return scene.of_views(*scene.shifted(shift_px)).after(
            BoundStep("A", self.amplitude, "units", "amplitude along each of two axes"),
            BoundStep("f", focal_px, "px", "focal length"),
            BoundStep("z1", near, "units", "nearest depth (1 % of the pixels are nearer)"),
            BoundStep(
                "d",
                shift_px,
                "px",
                "shift of its image; a cosine of frequency k changes by 2 sin(pi k d)",
                "sqrt(2) * A * f / z1",
            ),
        )

    def apply(self, signal: CameraPath, rig: RigFigures, rng: np.random.Generator) -> CameraPath:
        """Let the path tremble."""
        first, second = rng.uniform(0, 2 * np.pi, 2)
        return TremblingPath(signal, self.amplitude, self.hertz, (float(first), float(second)))
