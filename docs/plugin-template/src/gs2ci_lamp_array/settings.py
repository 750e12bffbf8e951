"""The driver's table in a rig file."""

from typing import Literal

from gs2ci.core.config import SIMULATED, ConfigTable, Count, Duration


class LampArrayOptions(ConfigTable):
    """[modulator] with kind = "lamp-array"."""

    kind: Literal["lamp-array"] = "lamp-array"
    port: str = SIMULATED
    """The tty ("/dev/serial/by-id/...") or "simulated"."""
    baud: Count = 115200
    timeout_s: Duration = 1.0
    """How long a reply may take."""
