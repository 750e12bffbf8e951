"""Options of a DLPC900: the [modulator] table with kind = "dlpc900", which is also the driver's options.

Here: `Dlpc900Options`, `TriggerEdges`. Not here: their encoding for the controller (`plan`, `payloads`).
"""

import struct
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from gs2ci.core.config import SIMULATED, ConfigTable, Duration
from gs2ci_drivers.dlpc900.firmware import DEFAULT_PROFILE, PROFILES

MIN_PULSE_US: Final = 20
LARGEST_EDGE_DELAY_US: Final = 20_000

EdgeDelay = Annotated[int, Field(ge=-MIN_PULSE_US, le=LARGEST_EDGE_DELAY_US)]


class TriggerEdges(ConfigTable):
    """[modulator.trigger_out_1] and [modulator.trigger_out_2]: edges relative to the pattern (0x1A1D, 0x1A1E)."""

    inverted: bool = False
    """Whether the active level is low, for sensors that expose while their line is low."""
    rise_us: EdgeDelay = 0
    """Delay of the rising edge."""
    fall_us: EdgeDelay = 0
    """Delay of the falling edge; without `inverted`, at least that of the rising one."""

    @model_validator(mode="after")
    def _rises_before_it_falls(self) -> Self:
        if not self.inverted and self.rise_us > self.fall_us:
            raise ValueError("rise_us must be at most fall_us unless inverted")
        return self

    def encode(self) -> bytes:
        """Return the five bytes of the setting."""
        return struct.pack("<Bhh", int(self.inverted), self.rise_us, self.fall_us)


class Dlpc900Options(ConfigTable):
    """[modulator] with kind = "dlpc900": a DMD behind a DLPC900 over USB HID."""

    kind: Literal["dlpc900"] = "dlpc900"
    port: str = SIMULATED
    """"usb", "usb:1-2.3" for one of several, or "simulated"."""
    firmware: str = DEFAULT_PROFILE
    """Profile of the firmware revision: what the count of a sequence counts, "rev-j" masks, "rev-f" passes."""
    trigger_out_1: TriggerEdges = TriggerEdges()
    """TRIG_OUT_1, the gate: relative to begin and end of each pattern."""
    trigger_out_2: TriggerEdges = TriggerEdges(fall_us=MIN_PULSE_US)
    """TRIG_OUT_2, the pulse: both edges relative to the begin of a pattern."""
    trigger_out_2_bit: Literal["", "disables", "enables"] = ""
    """What bit 0 of a pattern entry's byte 9 does to the pulse on TRIG_OUT_2; "" means unknown, and then no capture may
    use the pulses: `gs2ci doctor` finds it out. TI's guide says "disables", the code of TI's own GUI "enables"."""
    blocks: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]] | None = None
    """First block of mirrors to load, and how many: fewer switch faster. For 1-bit masks that are dark elsewhere."""
    idle_after: bool = True
    """Whether the mirrors keep flipping evenly after the device is closed, as TI recommends for a longer life."""
    leds: Annotated[int, Field(ge=0, le=7)] = 7
    """LED enables during a pattern: bit 0 red, 1 green, 2 blue."""
    lamp: Literal["", "switched", "continuous"] = ""
    """Whether the lamp follows the controller's LED enables ("switched") or stays on ("continuous"); "" means unknown.
    Only a switched lamp makes light in proportion to grey levels: with another, grey masks must be measured."""
    invert: bool = False
    """Whether the device inverts all patterns."""
    reply_timeout_s: Duration = 2.0
    """How long an answer may take."""
    wake_s: Duration = 3.0
    """How long leaving standby or mirror idling takes."""

    @model_validator(mode="after")
    def _known_profile(self) -> Self:
        if self.firmware not in PROFILES:
            raise ValueError(f"firmware = {self.firmware!r}; allowed: {', '.join(sorted(PROFILES))}")
        return self
