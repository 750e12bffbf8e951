"""Stage velocity ripple: a screw's pitch error varies the stage's speed periodically."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci.core.config import Positive
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.path import CameraPath, highest_hz, kinks_s
from gs2ci_sims.rig import RigFigures

# Steps in which the warp is inverted; between them it is taken for a line.
WARP_STEPS: Final = 4097


@dataclass(frozen=True)
class WarpedPath:
    """A path run through unevenly: at t the camera is where `base` is at t + delay sin(2 pi hz t + phase)."""

    base: CameraPath
    delay_s: float
    hertz: float
    phase: float

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion."""
        return max(self.hertz, highest_hz(self.base))

    def kinks_s(self, start_s: float, stop_s: float) -> F64:
        """Get when the velocity of the path beneath jumps, [K], as this one runs through it."""
        times = np.linspace(start_s, stop_s, WARP_STEPS)
        warped = times + self.delay_s * np.sin(2 * np.pi * self.hertz * times + self.phase)
        # A share of 1 at most keeps the warp from running backwards.
        return np.interp(kinks_s(self.base, float(warped[0]), float(warped[-1])), warped, times)

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]."""
        time = np.asarray(time_s, dtype=np.float64)
        return self.base.world_to_camera(time + self.delay_s * np.sin(2 * np.pi * self.hertz * time + self.phase))


@dataclass(frozen=True)
class StageRipple(EffectRecord):
    """Let the velocity along the path swing by a share, once per turn of the screw; the phase is drawn.

    Velocity v (1 + share cos(2 pi f t + p)) integrates to a position that is early by share / (2 pi f) sin(...).

    Args:
        share: Of the velocity, 0 to 1.
        hertz: Turns of the screw per second, more than 0.
    """

    stage: ClassVar[LightStage] = LightStage.MOTION
    cost_ns: ClassVar[float] = 0.1

    share: Annotated[float, Field(ge=0, le=1)]
    hertz: Positive

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What the image's shift changes: its speed times the most that the camera is early or late."""
        delay_s = self.share / (2 * np.pi * self.hertz)
        motion_px = float(scene.motion_px.max())
        shift_px = delay_s * motion_px / rig.timing.interval_s
        return scene.of_views(*scene.shifted(shift_px)).after(
            BoundStep("s", self.share, "", "share that the velocity swings by"),
            BoundStep("f", self.hertz, "Hz", "turns of the screw"),
            BoundStep("x", motion_px, "px", "motion of the image under one mask, at most"),
            BoundStep("T", rig.timing.interval_s, "s", "time on show of each mask"),
            BoundStep(
                "d",
                shift_px,
                "px",
                "shift of the image; a cosine of frequency k changes by 2 sin(pi k d)",
                "s / (2 * pi * f) * x / T",
            ),
        )

    def apply(self, signal: CameraPath, rig: RigFigures, rng: np.random.Generator) -> CameraPath:
        """Run through the path unevenly."""
        delay_s = self.share / (2 * np.pi * self.hertz)
        return WarpedPath(signal, delay_s, self.hertz, float(rng.uniform(0, 2 * np.pi)))
