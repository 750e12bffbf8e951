"""An axis of the stage as fitted to pictures, and the reasons to refuse it: no motion, slip, a wrong direction.

Here: the record and the tests of quality. Not here: the fit (`axes`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "stage"

MOVED_MIN: Final = 0.02
"""Share of the commanded distance below which a stage counts as not moving: a wrong lead screw or microstep setting
changes the distance by a factor of two to sixteen only."""
SCALE_RANGE: Final = (0.5, 2.0)
"""Allowed ratio of the measured to the commanded distance: outside it, a setting is wrong by a factor."""
ANGLE_MAX_DEG: Final = 30.0
"""Largest angle between the measured direction and the rig file's: beyond it, axis or mounting are different ones."""
OPPOSITE_DEG: Final = 150.0
SLIP_SHARE: Final = 0.002
"""Share of the travel: if returns to a target differ by more than this, the axis has slipped. Stages repeat to some
micrometres, 1e-4 of the travel."""
NOISE_FACTOR: Final = 5.0
"""A slip or a motion counts only if it exceeds the pictures' own noise this many times."""


@dataclass(frozen=True)
class Measured:
    """A number with its standard error, enlarged for few degrees of freedom so that twice its value covers 95 %."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class FittedAxis:
    """An axis before the camera's own uncertainty is added.

    Args:
        name: Name of the axis.
        per_mm: The camera's motion per mm of the axis, [3].
        covariance: Its covariance from scatter alone, [3, 3].
        backlash: Backlash along the axis, in mm of it.
        repeatability: Repeatability, likewise.
        worst_return_mm: Largest distance between two returns to one target from one side.
        linearity_mm: Rms residual of a straight line.
        travel_mm: Distance between the outermost targets.
        noise_mm: Error of one place by the pictures' noise.
        speed: Relative error of the speed, or None.
        speed_ripple_mm: Rms residual of a uniform motion, in mm of the axis.
        lag: As `AxisEstimate.sweep_lag_s`.
    """

    name: str
    per_mm: F64
    covariance: F64
    backlash: Measured
    repeatability: Measured
    worst_return_mm: float
    linearity_mm: float
    travel_mm: float
    noise_mm: float
    speed: Measured | None
    speed_ripple_mm: float
    lag: Measured | None = None

    @property
    def figures(self) -> F64:
        """Get the figures that depend on the camera's: motion per mm, backlash, speed error, lag of a sweep, [6]."""
        swept = [0.0 if one is None else one.value for one in (self.speed, self.lag)]
        return np.array([*self.per_mm, self.backlash.value, *swept])


def require_moving(name: str, per_mm: F64, travel_mm: float, noise_mm: float) -> None:
    """Check that an axis moves the camera by more than noise.

    Args:
        name: Name of the axis.
        per_mm: The camera's motion per mm of the axis, mm, [3].
        travel_mm: The commanded travel.
        noise_mm: Noise of one place of the camera.

    Raises:
        CalibrationError: It does not.
    """
    length = float(np.linalg.norm(per_mm))
    if length < MOVED_MIN or length * travel_mm < NOISE_FACTOR * noise_mm:
        raise CalibrationError(
            STEP,
            Reason.STAGE_STILL,
            f"axis {name} moves the camera by {length * travel_mm:.3g} mm over a commanded {travel_mm:g} mm",
            remedy="check that the camera stands on the stage, that its clamp is closed and the coupling holds",
        )


def require_faithful(axis: FittedAxis, expected: tuple[float, float, float] | None) -> None:
    """Check that an axis moves as the rig file says and returns to its targets.

    Raises:
        CalibrationError: It slips, or moves differently than the rig file says.
    """
    allowed_mm = max(SLIP_SHARE * axis.travel_mm, NOISE_FACTOR * axis.noise_mm)
    if max(axis.worst_return_mm, axis.linearity_mm) > allowed_mm:
        raise CalibrationError(
            STEP,
            Reason.STAGE_SLIPS,
            f"axis {axis.name} returns to a target with errors up to {axis.worst_return_mm:.3g} mm and leaves a "
            f"straight line by {axis.linearity_mm:.3g} mm (rms) over {axis.travel_mm:g} mm",
            allowed=f"{allowed_mm:.3g} mm",
            remedy="tighten coupling and clamps, move slower, take load off the stage, check that the board is firm",
        )
    length = float(np.linalg.norm(axis.per_mm))
    if not SCALE_RANGE[0] <= length <= SCALE_RANGE[1]:
        raise CalibrationError(
            STEP,
            Reason.STAGE_WRONG_WAY,
            f"axis {axis.name} moves the camera {length:.3g} times as far as it reports",
            allowed=f"{SCALE_RANGE[0]:g} to {SCALE_RANGE[1]:g} times",
            remedy="check the axis's microstep or steps per mm, and square_mm of the board",
        )
    if expected is not None and np.any(expected):
        _require_direction(axis, np.asarray(expected, dtype=np.float64))


def _require_direction(axis: FittedAxis, expected: F64) -> None:
    cosine = axis.per_mm @ expected / (np.linalg.norm(axis.per_mm) * np.linalg.norm(expected))
    angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    if angle_deg <= ANGLE_MAX_DEG:
        return
    raise CalibrationError(
        STEP,
        Reason.STAGE_WRONG_WAY,
        f"axis {axis.name} moves the camera by {np.round(axis.per_mm, 3).tolist()} per mm, {angle_deg:.0f} degrees off "
        f"{expected.tolist()} in [stage.mount]",
        allowed=f"{ANGLE_MAX_DEG:g} degrees",
        remedy="reverse the sign in [stage.mount], or the axis's"
        if angle_deg > OPPOSITE_DEG
        else "check which axis is plugged in where, or correct [stage.mount]",
    )
