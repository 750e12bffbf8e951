"""Options of a Zaber device: its [stage] table, which is also the driver's options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gs2ci.core.config import SIMULATED, ConfigTable, Count, Positive
from gs2ci_drivers.mount import MountOptions


class ZaberOptions(ConfigTable):
    """[stage] with kind = "zaber"."""

    kind: Literal["zaber"] = "zaber"
    port: str = SIMULATED
    """The tty ("/dev/serial/by-id/...") or "simulated"."""
    baud: Count = 115200
    """Bits per second of the line."""
    address: Annotated[int, Field(ge=1, le=99)] = 1
    """The device's address in its chain."""
    axes: dict[str, Count] = Field(default_factory=lambda: {"x": 1})
    """For each axis its number on the device, from 1."""
    microstep_mm: dict[str, Positive] = Field(default_factory=lambda: {"x": 0.000047625})
    """For each axis the travel of one microstep, from the data sheet."""
    resolution: Count = 64
    """Microsteps per full step for which `microstep_mm` holds: 64 is the factory setting, which data sheets assume."""
    own_speed_mm_s: dict[str, Positive] = Field(default_factory=dict)
    """For each axis its own top speed; only for firmware before 7.25, where a single move has no speed of its own. A
    sweep then changes `maxspeed`, which stays changed if the session is killed: connecting restores this value."""
    checksums: bool = True
    """Whether requests carry checksums; those in replies are always checked."""
    mount: MountOptions | None = None
    """How the stage moves the camera; leave it out if unknown."""

    @model_validator(mode="after")
    def _every_axis_has_a_microstep(self) -> Self:
        if set(self.axes) != set(self.microstep_mm):
            raise ValueError("axes and microstep_mm must name the same axes")
        return self
