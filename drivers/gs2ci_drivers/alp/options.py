"""Options of a ViALUX DMD: its [modulator] table, which is also the driver's options."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from gs2ci.core.config import SIMULATED, ConfigTable, Positive

FOLDER = "/usr/lib/x86_64-linux-gnu"
"""Where the maker's installer puts the library on Linux (alp4lib: ALP4.__init__)."""


class AlpOptions(ConfigTable):
    """[modulator] with kind = "alp": a ViALUX DMD (V-7000, V-7001, V-9501, ...). Needs the extra `alp`."""

    kind: Literal["alp"]
    port: Annotated[str, Field(pattern=r"^(simulated|usb(:\d+)?)$")] = SIMULATED
    """"usb", "usb:12345" with the serial number of one of several, or "simulated"."""
    version: Literal["4.1", "4.2", "4.3", "4.4", "5.0", "5.1"] = "4.3"
    """Of the maker's ALP library, which has to fit the controller board."""
    library: str = ""
    """Folder of the maker's library; without it, where its installer puts it."""
    trigger_active: Literal["high", "low"] = "high"
    """Level of a pulse on the gated synch output 1, which the sensor is wired to; the general one pulses for every
    picture, dark ones included."""
    pulse_us: Annotated[int, Field(ge=1, le=130_000)] = 100
    """Length of a pulse, but at most half the time that a mask is shown."""
    pitch_um: Positive = 13.68
    """Distance of neighbouring mirrors, which the device does not report: 13.68 (0.7" XGA), 10.8 (0.95" 1080p and 0.96"
    WUXGA), 7.56 (0.65" 1080p)."""
    invert: bool = False
    """Whether the device inverts all pictures."""

    @property
    def serial(self) -> int:
        """Get the serial number that is requested; 0 for any."""
        return int(self.port.partition(":")[2] or 0)

    @property
    def library_file(self) -> Path:
        """Get the file of the maker's library, by alp4lib's naming."""
        return Path(self.library or FOLDER) / f"libalp{self.version.replace('.', '')}.so"
