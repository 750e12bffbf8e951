"""Options of a Santec SLM-200 class panel: its [modulator] table, which is also the driver's options."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gs2ci.core.config import SIMULATED, ConfigTable, Delay, Duration
from gs2ci_drivers.display_slm.packets import TOP_LEVEL

Level = Annotated[int, Field(ge=0, le=TOP_LEVEL)]


class DisplaySlmOptions(ConfigTable):
    """[modulator] with kind = "santec": a Santec SLM-200 class panel over USB; experimental, for calibration only."""

    kind: Literal["santec"] = "santec"
    port: str = SIMULATED
    """"usb", "usb:1-2.3" for one of several, or "simulated"."""
    dark_level: Level = 0
    """The panel's grey level at which the optics block light."""
    bright_level: Level = TOP_LEVEL
    """The level at which they pass it; masks are linear in between."""
    min_exposure_s: Duration = 0.1
    """Shortest time on show: a command's round trip, a 120 Hz refresh, the crystal's response."""
    late_s: Delay = 0.03
    """How late the host may show a mask before the run counts as failed."""

    @model_validator(mode="after")
    def _two_levels(self) -> Self:
        if self.dark_level == self.bright_level:
            raise ValueError(f"dark_level and bright_level must be two different levels, 0 to {TOP_LEVEL}")
        return self
