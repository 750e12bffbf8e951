"""What a rig reads of every device's table, whatever its kind; for type checkers, and for authors of a device.

Here: the fields that all tables of modulators, sensors and stages have. Not here: those of one kind (its
options, in each driver's folder); which kinds there are (`plugin`).
"""

from typing import Any

from gs2ci.core.config import ConfigTable
from gs2ci.core.records import CfaPattern
from gs2ci_drivers.camera_options import CameraOptions
from gs2ci_drivers.mount import MountOptions


class DeviceTable(ConfigTable):
    """[modulator], and the part that every device's table has."""

    kind: str
    """Which driver."""
    port: str
    """Where the device is, or "simulated"."""


class SensorTable(DeviceTable, CameraOptions):
    """[sensor]."""

    top: int | None
    """First row of the region of interest."""
    format: str
    """Pixel format in the terms of its interface, "" for the present one."""
    gain_db: float | None
    """Gain."""
    buffers: int
    """Frame buffers."""
    controls: dict[str, Any]
    """Further controls by name."""

    @property
    def cfa(self) -> CfaPattern | None:
        """Get the colour mosaic of the format that is requested."""
        return None

    @property
    def bits(self) -> int | None:
        """Get the bits of the format that is requested; None if the present one is kept."""
        return None


class StageTable(DeviceTable):
    """[stage]."""

    axes: Any
    """Its axes by name."""
    mount: MountOptions | None
    """How it carries the camera."""
