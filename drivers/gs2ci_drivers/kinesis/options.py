"""Options of a Thorlabs motion controller: its [stage] table, which is also the driver's options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gs2ci.core.config import SIMULATED, ConfigTable, Count, Positive
from gs2ci_drivers.kinesis.stages import STAGES
from gs2ci_drivers.mount import MountOptions

Bay = Annotated[int, Field(ge=0, le=10)]


class KinesisOptions(ConfigTable):
    """[stage] with kind = "kinesis": a Thorlabs K-Cube, T-Cube, benchtop controller or integrated stage."""

    kind: Literal["kinesis"] = "kinesis"
    port: str = SIMULATED
    """The tty ("/dev/serial/by-id/...") or "simulated"."""
    baud: Count = 115200
    """Bits per second of the line."""
    axes: Annotated[dict[str, Bay], Field(min_length=1)] = Field(default_factory=lambda: {"x": 0})
    """For each axis the bay of a benchtop controller (BBD, BSC), from 1; 0 for a cube or an integrated stage, which has
    one axis."""
    stages: dict[str, str] = Field(default_factory=lambda: {"x": "MTS50-Z8"})
    """For each axis the model of its stage, which only brushless controllers are asked for: "MTS25-Z8", "MTS50-Z8",
    "Z812", "Z825", "MLS203-X", "MLS203-Y", "DDSM50", "DDSM100", "DDS220", "LTS150" or "LTS300"."""
    counts_per_mm: dict[str, Positive] = Field(default_factory=dict)
    """For an axis its encoder counts per mm, if they are others than the model's: a Z8 stage with a gear of 67:1 has
    34304 instead of 34554.96. A brushless controller's own word is then not asked for."""
    mount: MountOptions | None = None
    """How the stage moves the camera; leave it out if unknown."""

    @model_validator(mode="after")
    def _every_axis_has_a_stage(self) -> Self:
        if set(self.axes) != set(self.stages) or not set(self.counts_per_mm) <= set(self.axes):
            raise ValueError("axes and stages must name the same axes, and counts_per_mm some of them")
        unknown = sorted(set(self.stages.values()) - STAGES.keys())
        if unknown:
            raise ValueError(f"stages has {', '.join(map(repr, unknown))}; allowed: {', '.join(STAGES)}")
        if len(set(self.axes.values())) != len(self.axes):
            raise ValueError("axes must have different bays")
        return self
