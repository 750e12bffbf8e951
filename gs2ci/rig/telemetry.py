"""Camera poses from reported stage positions: by the calibration if it measured the axes, otherwise by the rig file.

Here: how a capture's stage moves the camera, and the poses of a row. Not here: measuring it (the step `stage`,
`gs2ci_calibration.geometry`), the stage's position at each mask (`gs2ci_drivers.acquisition`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import rigid
from gs2ci.rig.calibrated import Calibrated, MeasuredAxis
from gs2ci.rig.config import RigTable
from gs2ci_drivers.plan import Travel


@dataclass(frozen=True)
class Carriage:
    """How the stage moves the camera in a capture.

    Args:
        travel: The travel of the capture.
        per_mm: The camera's motion per counted mm of each axis at rest, in its own frame (x right, y down, z ahead),
            in the unit of the poses, [3].
        swept_per_mm: The same of the swept axis while it moves.
        ahead_mm: True minus counted position of the swept axis while it moves, counted mm: the distance travelled
            during the delay of a position query, less half the backlash, by which it lags behind the mean of both
            directions.
        provenance: The source of these figures, for the shot's provenance.
        zero_mm: Where places of the stage are counted from, counted mm, for each axis that has such a place: in a
            simulated world, whose scene stands where the camera rests, that of the swept axis, or none. None: from 0
            of each axis.
    """

    travel: Travel
    per_mm: Mapping[str, F64]
    swept_per_mm: F64
    provenance: Mapping[str, Any] = field(default_factory=dict)
    ahead_mm: float = 0.0
    zero_mm: Mapping[str, float] | None = None

    def world_to_camera(self, stage_mm: F64, axes: tuple[str, ...]) -> F64:
        """Return the camera's poses, [N, 4, 4], OpenCV axes: identity in the middle of the travel.

        Args:
            stage_mm: Counted positions, [N, K].
            axes: Their names, [K].
        """
        shift = np.zeros((len(stage_mm), 3))
        for column, axis in enumerate(axes):
            rest_mm = self._rest_mm(axis, stage_mm[0, column])
            per_mm = self.per_mm.get(axis, np.zeros(3))
            if axis != self.travel.axis:
                shift -= (stage_mm[:, column] - rest_mm)[:, None] * per_mm
                continue
            # The position was read when the travel began; from there on positions follow from the speed.
            begin_mm = self.travel.from_mm
            shift -= (begin_mm - rest_mm + self.ahead_mm) * per_mm
            shift -= (stage_mm[:, column] - begin_mm)[:, None] * self.swept_per_mm
        return rigid(np.eye(3), shift)

    def origin(self, stage_mm: F64, axes: tuple[str, ...]) -> F64:
        """Return where the camera is whose pose is the identity, by which captures of one stage share a frame.

        Args:
            stage_mm: Counted positions, [N, K].
            axes: Their names, [K].

        Returns:
            Its place in its own axes and the unit of the poses, from where the stage counts, [3]. An axis whose
            direction is unknown is left out.
        """
        found = np.zeros(3)
        for axis, first_mm in zip(axes, stage_mm[0], strict=True):
            rest_mm = self._rest_mm(axis, first_mm)
            zero_mm = 0.0 if self.zero_mm is None else self.zero_mm.get(axis, rest_mm)
            found += (rest_mm - zero_mm) * self.per_mm.get(axis, np.zeros(3))
        return found

    def _rest_mm(self, axis: str, first_mm: float) -> float:
        """Return the counted position of an axis at which the pose is the identity."""
        return (self.travel.from_mm + self.travel.to_mm) / 2 if axis == self.travel.axis else first_mm


def carriage_of(
    table: RigTable, travel: Travel | None, calibrated: Calibrated | None, speed_mm_s: float = 0.0
) -> Carriage | None:
    """Return how the stage moves the camera, or None if it is at rest or the direction of the motion is unknown.

    An axis that the calibration measured is taken from it, others from [stage.mount]; the swept axis must be known.

    Args:
        table: The rig file.
        travel: The travel of the capture, None if the camera is at rest.
        calibrated: The bundle, None without one.
        speed_mm_s: Counted speed of the sweep: corrections by measured times are proportional to it.
    """
    if table.stage is None or travel is None:
        return None
    mount = table.stage.mount
    # The rig file of a real stage may keep the [world] in which it was tried.
    simulated = table.world if "stage" in table.simulated else None
    unit = 1.0 if simulated is None else simulated.scene_units_per_mm
    per_mm = {} if mount is None else {axis: np.array(getattr(mount, axis), np.float64) for axis in ("x", "y", "z")}
    measured = {} if calibrated is None else calibrated.axes
    per_mm |= {axis: found.per_mm for axis, found in measured.items()}
    if travel.axis not in per_mm:
        return None
    swept = measured.get(travel.axis)
    # Counted positions in a sweep are commanded speed times time: the error of the true speed scales them.
    swept_per_mm = per_mm[travel.axis] * (1.0 if swept is None else 1.0 + swept.speed_error)
    provenance: dict[str, Any] = {"axes_from": "[stage.mount]"} if swept is None else _axis_record(swept, travel.axis)
    if mount is not None and mount.error_mm is not None:
        provenance["position_error"] = unit * mount.error_mm
    if simulated is not None:
        provenance["unit_mm"] = 1 / unit
    if mount is not None and mount.turn_error_deg is not None:
        provenance["turn_error_deg"] = mount.turn_error_deg
    ahead_mm = 0.0
    if swept is not None and calibrated is not None:
        ahead_mm, error_mm = _ahead_of_count(swept, calibrated, travel, speed_mm_s)
        provenance |= {"ahead_mm": round(ahead_mm, 6), "ahead_error_mm": round(error_mm, 6)}
    zero_mm = None
    if simulated is not None:
        zero_mm = {} if simulated.rest_mm is None else {travel.axis: simulated.rest_mm}
    in_unit = {axis: unit * way for axis, way in per_mm.items()}
    return Carriage(travel, in_unit, unit * swept_per_mm, provenance, ahead_mm, zero_mm)


def _ahead_of_count(
    swept: MeasuredAxis, calibrated: Calibrated, travel: Travel, speed_mm_s: float
) -> tuple[float, float]:
    """Return true minus counted position of an axis during a sweep, and its standard error, in counted mm.

    The error is common to all poses of a shot. It combines the errors of the measured times and of the backlash, the
    repeatability of a sweep, and the speed error times half the travel.
    """
    way = 1.0 if travel.to_mm > travel.from_mm else -1.0
    lag_s, lag_error_s = swept.sweep_lag_s or (0.0, 0.0)
    play_mm, play_error_mm = swept.backlash_mm
    times_s = [pair[1] for pair in (calibrated.late_s, calibrated.longer_s) if pair is not None]
    errors_mm = [
        *(speed_mm_s * one for one in (lag_error_s, *times_s)),
        play_error_mm / 2,
        swept.repeatability_mm,
        swept.speed_error * abs(travel.to_mm - travel.from_mm) / 2,
    ]
    return way * (speed_mm_s * lag_s - play_mm / 2), float(np.linalg.norm(errors_mm))


def _axis_record(swept: MeasuredAxis, axis: str) -> dict[str, Any]:
    return {
        "axes_from": "calibration",
        "measured_utc": swept.measured_utc,
        f"direction_{axis}": [round(float(part), 6) for part in swept.direction],
        f"scale_{axis}": round(swept.scale, 6),
        f"velocity_error_{axis}": round(swept.speed_error, 6),
    }
