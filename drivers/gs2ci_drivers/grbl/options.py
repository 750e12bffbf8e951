"""Options of a GRBL controller: its [stage] table, which is also the driver's options."""

from typing import Annotated, Literal

from pydantic import Field

from gs2ci.core.config import SIMULATED, ConfigTable, Count
from gs2ci_drivers.mount import MountOptions


class GrblOptions(ConfigTable):
    """[stage] with kind = "grbl"."""

    kind: Literal["grbl"] = "grbl"
    port: str = SIMULATED
    """The tty ("/dev/serial/by-id/...") or "simulated"."""
    baud: Count = 115200
    """Bits per second of the line."""
    axes: Annotated[tuple[Literal["x", "y", "z"], ...], Field(min_length=1)] = ("x",)
    """Which axes of the controller are in use."""
    mount: MountOptions | None = None
    """How the stage moves the camera; leave it out if unknown."""
