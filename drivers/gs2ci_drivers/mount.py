"""How a stage carries the camera: the table [stage.mount] of a rig file, the same for every kind of stage."""

import math
from typing import Annotated, Final

from pydantic import AfterValidator, Field

from gs2ci.core.config import ConfigTable

# From half to twice what the axis is told: beyond, a calibration of the stage says that it goes the wrong way. A
# direction alone, a length in metres and a row of zeros are none.
_LENGTHS: Final = (0.5, 2.0)


def _of_a_length(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the camera's motion per mm of an axis, if it can be that.

    Raises:
        ValueError: It is far too short or too long.
    """
    length, (least, most) = math.hypot(*vector), _LENGTHS
    if not least <= length <= most:
        raise ValueError(
            f"its length is {length:.3g}, but the motion of the camera in mm per mm of the axis is from {least:g} to "
            f"{most:g}, such as [1.0, 0.0, 0.0]"
        )
    return vector


Vector = Annotated[tuple[float, float, float], AfterValidator(_of_a_length)]


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
