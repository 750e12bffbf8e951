"""The camera's path: poses over continuous time.

Here: the interface, and stage motions of constant and of reversing velocity. Not here: their sampling (`exposure`,
`planner`).
"""

from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from pydantic import FiniteFloat
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.cameras import rigid
from gs2ci.core.config import NotNegative, Positive
from gs2ci.core.errors import InputError
from gs2ci_sims.scene import Scene

# The three axes wobble with the same frequency, a third of a period apart, so that they are never all at rest.
WOBBLE_PHASES: Final = np.array([0.0, 2.0, 4.0]) * np.pi / 3


class CameraPath(Protocol):
    """A camera in motion."""

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4] for [T], OpenCV axes."""


def highest_hz(path: CameraPath) -> float:
    """Get the highest frequency in a path's motion, 0 if the path does not state one."""
    return float(getattr(path, "highest_hz", 0.0))


def kinks_s(path: CameraPath, start_s: float, stop_s: float) -> F64:
    """Get the times at which a path's velocity jumps between two times, [K]; none if the path does not state them."""
    told = getattr(path, "kinks_s", None)
    return np.zeros(0) if told is None else np.asarray(told(start_s, stop_s), dtype=np.float64)


@dataclass(frozen=True)
class StageMove(BoundedRecord):
    """A linear stage at constant velocity, passing the reference pose at time 0, with a tiny angular wobble.

    Args:
        velocity: Velocity along the reference camera's axes (x right, y down, z forward), scene units per second, [3].
        wobble_deg: Amplitude of the wobble about each axis, in degrees (a stage's pitch, yaw and roll errors).
        wobble_hz: Its frequency.
        reference_world_to_camera: Pose at time 0 without wobble, [4, 4].
    """

    velocity: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    wobble_deg: FiniteFloat = 0.0
    wobble_hz: NotNegative = 0.0
    reference_world_to_camera: F64 = field(default_factory=lambda: np.eye(4), repr=False)

    @property
    def highest_hz(self) -> float:
        """Get the highest frequency in the motion: the wobble's."""
        return self.wobble_hz

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]: translation along the rail, then rotation about the camera."""
        time = np.asarray(time_s, dtype=np.float64)
        angles = np.sin(2 * np.pi * self.wobble_hz * time[:, None] + WOBBLE_PHASES)
        moved = rigid(np.eye(3), -time[:, None] * np.array(self.velocity))
        if self.wobble_deg == 0:
            return moved @ self.reference_world_to_camera
        turned = rigid(Rotation.from_rotvec(np.deg2rad(self.wobble_deg) * angles).as_matrix(), np.zeros(3))
        return turned @ moved @ self.reference_world_to_camera


def stage_move_for_parallax(
    scene: Scene,
    parallax_px: float,
    duration_s: float,
    *,
    direction: tuple[float, float, float] = (1.0, 0.3, 0.1),
    wobble_deg: float = 0.05,
) -> StageMove:
    """Choose the stage's velocity so that near and far of a scene shift against each other by `parallax_px`.

    Args:
        scene: The scene; its near and far depths contain 98 % of its pixels.
        parallax_px: Shift over `duration_s`, in pixels of the scene's camera: f b (1/near - 1/far), where b is the
            motion across the line of sight.
        duration_s: The exposure's duration.
        direction: Direction of the motion; its length is ignored.
        wobble_deg: Amplitude of the wobble, which has one and a third periods during the exposure.

    Raises:
        InputError: The duration or the direction across the line of sight is zero, or the scene has no depth.
    """
    near, far = scene.depth_range()
    across = float(np.hypot(direction[0], direction[1]))
    if duration_s <= 0 or across == 0 or parallax_px < 0:
        raise InputError(
            f"a move along {direction} for a parallax of {parallax_px} px in {duration_s} s",
            allowed="a positive duration, parallax >= 0, and a direction across the line of sight",
        )
    if 1 / near - 1 / far < 1e-6 / near:
        raise InputError(
            f"scene {scene.name!r} lies at one depth ({near:.4g}): no move gives it parallax",
            remedy="give the stage's velocity instead",
        )
    length = parallax_px / (scene.intrinsics[0, 0] * (1 / near - 1 / far))
    velocity = np.array(direction) / across * length / duration_s
    return StageMove(
        (float(velocity[0]), float(velocity[1]), float(velocity[2])),
        wobble_deg,
        wobble_hz=4 / (3 * duration_s),
        reference_world_to_camera=scene.world_to_camera,
    )


@dataclass(frozen=True)
class ReversingMove(BoundedRecord):
    """A stage that moves back and forth: a triangle wave through the reference pose, which it passes at time 0.

    Args:
        velocity: Velocity of the forward motion, along the reference camera's axes, scene units per second, [3].
        period_s: Period of the motion, more than 0; it reverses at a quarter and three quarters.
        reference_world_to_camera: Pose at time 0, [4, 4].
    """

    velocity: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    period_s: Positive
    reference_world_to_camera: F64 = field(default_factory=lambda: np.eye(4), repr=False)

    @property
    def highest_hz(self) -> float:
        """Get the highest relevant frequency: that of the reversals."""
        return 1.0 / self.period_s

    def kinks_s(self, start_s: float, stop_s: float) -> F64:
        """Get the times at which the stage reverses between two times, [K]."""
        halves = np.arange(np.ceil(2 * start_s / self.period_s - 0.5), np.floor(2 * stop_s / self.period_s - 0.5) + 1)
        return (halves + 0.5) * 0.5 * self.period_s

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]."""
        time = np.asarray(time_s, dtype=np.float64)
        phase = np.mod(time / self.period_s + 0.25, 1.0)
        travelled_s = self.period_s * (0.25 - np.abs(phase - 0.5))
        return rigid(np.eye(3), -travelled_s[:, None] * np.array(self.velocity)) @ self.reference_world_to_camera
