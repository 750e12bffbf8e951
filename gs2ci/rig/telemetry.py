"""Camera poses from what the stage reports: by the calibration where it measured the axes, else as the rig file says.

Here: how a capture's stage carries the camera, and the poses of a row. Not here: measuring it (the step `stage`,
`gs2ci_calibration.geometry`), where the stage is at each mask (`gs2ci_drivers.acquisition`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.rig.calibrated import Calibrated, MeasuredAxis
from gs2ci.rig.config import RigTable
from gs2ci_drivers.plan import Travel


@dataclass(frozen=True)
class Carriage:
    """How the stage carries the camera in a capture that moves it.

    Args:
        travel: Of the capture.
        per_mm: The camera's motion per counted mm of each axis at rest, in its own frame (x right, y down, z ahead),
            in the unit of the poses, [3].
        swept_per_mm: The same of the swept axis while it moves.
        told: Where these are from, for the shot's provenance.
    """

    travel: Travel
    per_mm: Mapping[str, F64]
    swept_per_mm: F64
    told: Mapping[str, Any] = field(default_factory=dict)

    def world_to_camera(self, stage_mm: F64, axes: tuple[str, ...]) -> F64:
        """Return the camera's poses, [N, 4, 4], OpenCV axes: identity in the middle of the travel.

        Args:
            stage_mm: Counted positions, [N, K].
            axes: Their names, [K].
        """
        poses = np.tile(np.eye(4), (len(stage_mm), 1, 1))
        for column, axis in enumerate(axes):
            swept = axis == self.travel.axis
            rest_mm = (self.travel.from_mm + self.travel.to_mm) / 2 if swept else stage_mm[0, column]
            per_mm = self.swept_per_mm if swept else self.per_mm.get(axis, np.zeros(3))
            poses[:, :3, 3] -= (stage_mm[:, column] - rest_mm)[:, None] * per_mm
        return poses


def carriage_of(table: RigTable, travel: Travel | None, calibrated: Calibrated | None) -> Carriage | None:
    """Return how the stage carries the camera, or None where nothing moves or nothing tells where to.

    An axis that the calibration measured is taken from it, another from [stage.mount]; the swept axis must be known.
    """
    if table.stage is None or travel is None:
        return None
    mount = table.stage.mount
    unit = table.world.scene_units_per_mm if table.world else 1.0
    per_mm = {} if mount is None else {axis: np.array(getattr(mount, axis), np.float64) for axis in ("x", "y", "z")}
    measured = {} if calibrated is None else calibrated.axes
    per_mm |= {axis: found.per_mm for axis, found in measured.items()}
    if travel.axis not in per_mm:
        return None
    swept = measured.get(travel.axis)
    # Counted positions in a sweep are the commanded speed times the time: the true speed's error scales them.
    swept_per_mm = per_mm[travel.axis] * (1.0 if swept is None else 1.0 + swept.speed_error)
    told: dict[str, Any] = {"axes_from": "[stage.mount]"} if swept is None else _told(swept, travel.axis)
    if mount is not None and mount.error_mm is not None:
        told["position_error"] = unit * mount.error_mm
    return Carriage(travel, {axis: unit * way for axis, way in per_mm.items()}, unit * swept_per_mm, told)


def _told(swept: MeasuredAxis, axis: str) -> dict[str, Any]:
    return {
        "axes_from": "calibration",
        "measured_utc": swept.measured_utc,
        f"direction_{axis}": [round(float(part), 6) for part in swept.direction],
        f"scale_{axis}": round(swept.scale, 6),
        f"velocity_error_{axis}": round(swept.speed_error, 6),
    }
