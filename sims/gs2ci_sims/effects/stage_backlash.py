"""Stage backlash: after a reversal the stage stands still until the play is taken up."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import NOTHING, Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.path import CameraPath, highest_hz, kinks_s
from gs2ci_sims.rig import RigFigures

# The path is followed in so many steps to find its reversals.
STEPS: Final = 1024


@dataclass(frozen=True)
class LaggingPath:
    """A path whose camera lags by up to `play` along its direction after each reversal.

    Args:
        base: Where the drive wants the camera.
        play: Lost motion, scene units.
        begin_s: From when on the motion is followed; before, the play is taken up in the first direction.
        end_s: Until when.
    """

    base: CameraPath
    play: float
    begin_s: float
    end_s: float

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion."""
        return highest_hz(self.base)

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

    stage: ClassVar[LightStage] = LightStage.MOTION
    cost_ns: ClassVar[float] = 1.0

    play: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """What the largest lag shifts the image of the nearest point by; nothing where the path never turns back."""
        lagging = self._lagging(scene.path, rig)
        worst = float(np.abs(lagging.lag(np.linspace(lagging.begin_s, lagging.end_s, STEPS))).max())
        if worst <= 1e-9 * self.play:
            return NOTHING.by("0", BoundStep("play", self.play, "units", "lost motion; the path does not turn back"))
        near, focal_px = scene.scene.depth_range()[0], float(scene.scene.intrinsics[:2, :2].max())
        return scene.of_views(*scene.shifted(worst * focal_px / near)).after(
            BoundStep("play", self.play, "units", "lost motion"),
            BoundStep("lag", worst, "units", "largest lag after the turns of this path"),
            BoundStep("f", focal_px, "px", "focal length"),
            BoundStep("z1", near, "units", "nearest depth (1 % of the pixels are nearer)"),
            BoundStep(
                "d",
                worst * focal_px / near,
                "px",
                "shift of its image; a cosine of frequency k changes by 2 sin(pi k d)",
                "lag * f / z1",
            ),
        )

    def apply(self, signal: CameraPath, rig: RigFigures, rng: np.random.Generator) -> CameraPath:
        """Let the path lag."""
        return self._lagging(signal, rig)

    def _lagging(self, path: CameraPath, rig: RigFigures) -> LaggingPath:
        half = 0.5 * rig.exposure_s
        return LaggingPath(path, self.play, -half, half)
