"""How a stage carries the camera: the table [stage.mount] of a rig file, the same for every kind of stage."""

from typing import Annotated

from pydantic import Field

from gs2ci.core.config import ConfigTable

Vector = tuple[float, float, float]


class MountOptions(ConfigTable):
    """[stage.mount]: how the stage carries the camera, in the camera's own frame (x right, y down, z ahead)."""

    x: Vector = (1.0, 0.0, 0.0)
    """The camera's motion per mm of the axis, in mm. A calibration of the stage goes before it."""
    y: Vector = (0.0, 1.0, 0.0)
    """Likewise."""
    z: Vector = (0.0, 0.0, 1.0)
    """Likewise."""
    error_mm: Annotated[float, Field(gt=0)] | None = None
    """Standard error of the positions that the stage reports, mm. It limits how far a reconstruction moves the poses;
    without it, a reconstruction assumes 1 % of the path."""
    turn_error_deg: Annotated[float, Field(gt=0, le=90)] | None = None
    """By how many degrees the stage may turn the camera from the first to the last position of a path (standard error):
    its pitch, yaw and roll. A turn moves a picture as another depth does, so that depths and lengths err with it;
    without it, a reconstruction assumes 0.1 px."""
