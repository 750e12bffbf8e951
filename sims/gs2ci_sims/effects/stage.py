"""Effects on the path of the camera.

- Stage velocity ripple: a screw's pitch error varies the stage's speed periodically.
- Stage vibration: the camera trembles about its path.
- Stage backlash: after a reversal the stage stands still until the play is taken up.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative, Positive
from gs2ci_sims.effects.base import NOTHING, Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.path import CameraPath, highest_hz, kinks_s
from gs2ci_sims.rig import RigFigures

# Steps in which the warp is inverted; between them it is taken for a line.
WARP_STEPS: Final = 4097


@dataclass(frozen=True)
class _ChangedPath:
    """A path that an effect makes of another one, whose frequencies and kinks it has unless it says otherwise."""

    base: CameraPath

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion."""
        return highest_hz(self.base)

    def kinks_s(self, start_s: float, stop_s: float) -> F64:
        """Get when the velocity jumps, [K]."""
        return kinks_s(self.base, start_s, stop_s)


@dataclass(frozen=True)
class WarpedPath(_ChangedPath):
    """A path run through unevenly: at t the camera is where `base` is at t + delay sin(2 pi hz t + phase)."""

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

    stage = LightStage.MOTION
    cost_ns = 0.1

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

    def apply(self, signal: CameraPath, rig: RigFigures, rng: Rng) -> CameraPath:
        """Run through the path unevenly."""
        delay_s = self.share / (2 * np.pi * self.hertz)
        return WarpedPath(signal, delay_s, self.hertz, float(rng.uniform(0, 2 * np.pi)))


@dataclass(frozen=True)
class TremblingPath(_ChangedPath):
    """A path whose camera is displaced by amplitude sin(2 pi hz t + phases) along its right and down axes."""

    amplitude: float
    hertz: float
    phases: tuple[float, float]

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion."""
        return max(self.hertz, highest_hz(self.base))

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

    stage = LightStage.MOTION
    cost_ns = 0.1

    amplitude: NotNegative
    hertz: Positive

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What shifting the image of the nearest point by the amplitude along both axes changes."""
        amplitude = BoundStep("A", self.amplitude, "units", "amplitude along each of two axes")
        return _displaced(scene, 2**0.5 * self.amplitude, "sqrt(2) * A", amplitude)

    def apply(self, signal: CameraPath, rig: RigFigures, rng: Rng) -> CameraPath:
        """Let the path tremble."""
        first, second = rng.uniform(0, 2 * np.pi, 2)
        return TremblingPath(signal, self.amplitude, self.hertz, (float(first), float(second)))


# The path is followed in so many steps to find its reversals.
STEPS: Final = 1024


@dataclass(frozen=True)
class LaggingPath(_ChangedPath):
    """A path whose camera lags by up to `play` along its direction after each reversal.

    Args:
        base: Where the drive wants the camera.
        play: Lost motion, scene units.
        begin_s: From when on the motion is followed; before, the play is taken up in the first direction.
        end_s: Until when.
    """

    play: float
    begin_s: float
    end_s: float

    def kinks_s(self, start_s: float, stop_s: float) -> F64:
        """Get when the velocity jumps, [K]: at the turns of the path beneath, and when the play is taken up or left."""
        times, lag, _ = self._followed
        slack = np.abs(np.diff(lag)) > 1e-9 * max(self.play, 1e-300)
        taken_up = times[1:-1][slack[1:] != slack[:-1]]
        kinks = np.concatenate([kinks_s(self.base, start_s, stop_s), taken_up])
        return np.sort(kinks[(kinks > start_s) & (kinks < stop_s)])

    @cached_property
    def _followed(self) -> tuple[F64, F64, F64]:
        """Times [T], lag at these [T], and the direction of motion [3] in world axes."""
        times = np.linspace(self.begin_s, self.end_s, STEPS)
        centres = _centres(self.base.world_to_camera(times))
        spread = centres - centres.mean(axis=0)
        direction = np.linalg.svd(spread, full_matrices=False)[2][0]
        wanted = spread @ direction
        moving = np.flatnonzero(np.abs(np.diff(wanted)) > 1e-12 * max(float(np.ptp(wanted)), 1e-300))
        if len(moving) and wanted[moving[0] + 1] < wanted[moving[0]]:
            direction, wanted = -direction, -wanted
        lag = np.zeros(STEPS)
        reached = float(wanted[0])
        for step, place in enumerate(wanted.tolist()):
            # Driven forwards the camera is where the drive is; driven back it waits until the play is used up.
            reached = min(max(reached, place), place + self.play)
            lag[step] = reached - place
        return times, lag, direction

    def lag(self, time_s: F64) -> F64:
        """Get by how much the camera is beyond where it should be, along the first direction of motion, [T]."""
        times, lag, _ = self._followed
        return np.interp(time_s, times, lag)

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]."""
        time = np.asarray(time_s, dtype=np.float64)
        poses = np.array(self.base.world_to_camera(time))
        shift = self.lag(time)[:, None] * self._followed[2]
        poses[:, :3, 3] -= np.einsum("tij,tj->ti", poses[:, :3, :3], shift)
        return poses


def _centres(world_to_camera: F64) -> F64:
    return np.asarray(-np.einsum("tji,tj->ti", world_to_camera[:, :3, :3], world_to_camera[:, :3, 3]))


@dataclass(frozen=True)
class StageBacklash(EffectRecord):
    """Let the camera lag after each reversal of the stage: the play operator.

    A path that never turns back is not changed: the play is taken up before the exposure (ISO 230-2 calls the lost
    motion reversal error).

    Args:
        play: Lost motion, scene units, at least 0.
    """

    stage = LightStage.MOTION
    cost_ns = 1.0

    play: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What the largest lag shifts the image of the nearest point by; nothing where the path never turns back."""
        lagging = self._lagging(scene.path, rig)
        worst = float(np.abs(lagging.lag(np.linspace(lagging.begin_s, lagging.end_s, STEPS))).max())
        if worst <= 1e-9 * self.play:
            return NOTHING.by("0", BoundStep("play", self.play, "units", "lost motion; the path does not turn back"))
        play = BoundStep("play", self.play, "units", "lost motion")
        lag = BoundStep("lag", worst, "units", "largest lag after the turns of this path")
        return _displaced(scene, worst, "lag", play, lag)

    def apply(self, signal: CameraPath, rig: RigFigures, rng: Rng) -> CameraPath:
        """Let the path lag."""
        return self._lagging(signal, rig)

    def _lagging(self, path: CameraPath, rig: RigFigures) -> LaggingPath:
        half = 0.5 * rig.exposure_s
        return LaggingPath(path, self.play, -half, half)


def _displaced(scene: Previewed, aside: float, law: str, *steps: BoundStep) -> Bound:
    """Bound what a camera so far aside, scene units, changes: it shifts the image of the nearest point most."""
    near, focal_px = scene.scene.depth_range()[0], float(scene.scene.intrinsics[:2, :2].max())
    shift_px = aside * focal_px / near
    shift = "shift of its image; a cosine of frequency k changes by 2 sin(pi k d)"
    return scene.of_views(*scene.shifted(shift_px)).after(
        *steps,
        BoundStep("f", focal_px, "px", "focal length"),
        BoundStep("z1", near, "units", "nearest depth (1 % of the pixels are nearer)"),
        BoundStep("d", shift_px, "px", shift, f"{law} * f / z1"),
    )
