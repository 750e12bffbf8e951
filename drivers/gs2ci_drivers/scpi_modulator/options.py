"""Options of a modulator behind the open command set: its [modulator] table, which is also the driver's options."""

from typing import Literal

from gs2ci.core.config import SIMULATED, ConfigTable, Count, Duration


class ScpiOptions(ConfigTable):
    """[modulator] with kind = "scpi": the open command set over a serial line (docs/scpi-modulator.md)."""

    kind: Literal["scpi"] = "scpi"
    port: str = SIMULATED
    """The tty ("/dev/serial/by-id/...") or "simulated"."""
    baud: Count = 115200
    """Bits per second of the line."""
    timeout_s: Duration = 2.0
    """How long a reply may take."""
