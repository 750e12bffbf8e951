"""The one record by which a device is known: the [table] of its settings, its port, its driver, its twin.

A built-in device has its record in `plugin.py` of its own folder, named in `BUILT_IN`; another package's is the object
of an entry point of the groups `gs2ci.modulators`, `gs2ci.sensors` and `gs2ci.stages` (`docs/plugins.md` shows one).
Here: the record, and finding one by the `kind` that a rig file names. Not here: opening (`gs2ci.rig`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pkgutil import resolve_name
from typing import Any, Final, Literal, get_args

from gs2ci.core.clock import Clock
from gs2ci.core.config import ConfigTable
from gs2ci.core.plugins import PluginError, load
from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.ports import BytePort, CameraPort, HidPort, LibraryPort, ScreenPort, SysPort
from gs2ci_drivers.sensor import Sensor
from gs2ci_drivers.stage import Stage

Port = BytePort | HidPort | SysPort | CameraPort | ScreenPort | LibraryPort
PortKind = Literal["bytes", "hid", "sys", "camera", "screen", "library"]
Access = Literal["tty", "usb", "video", "gentl", "library", "none"]

BUILT_IN: Final[dict[str, dict[str, str]]] = {
    "gs2ci.modulators": {
        "dlpc900": "gs2ci_drivers.dlpc900.plugin:DLPC900",
        "scpi": "gs2ci_drivers.scpi_modulator.plugin:SCPI",
        "santec": "gs2ci_drivers.display_slm.plugin:SANTEC",
        "video": "gs2ci_drivers.video_out.plugin:VIDEO",
        "alp": "gs2ci_drivers.alp.plugin:ALP",
    },
    "gs2ci.sensors": {
        "v4l2": "gs2ci_drivers.v4l2.plugin:V4L2",
        "genicam": "gs2ci_drivers.genicam.plugin:GENICAM",
    },
    "gs2ci.stages": {
        "zaber": "gs2ci_drivers.zaber.plugin:ZABER",
        "grbl": "gs2ci_drivers.grbl.plugin:GRBL",
        "kinesis": "gs2ci_drivers.kinesis.plugin:KINESIS",
    },
}
"""Group of entry points -> kind of a built-in device -> its record, as an entry point would name it."""


@dataclass(frozen=True)
class DriverPlugin:
    """A driver, built in or from another package.

    Args:
        settings: The device's table in a rig file: a `ConfigTable` with `kind: Literal["NAME"]`, NAME being the entry
            point's, and `port: str`, for which "simulated" requests the twin. A sensor's or a stage's table also needs
            the fields that the rig reads of every one (`gs2ci_drivers.tables`): inherit from `V4l2Options` or
            `ZaberOptions`.
        port: Opens the real port from the device's name and its settings.
        driver: Makes the device from its name, the open port, the clock and the settings. It closes the port.
        port_kind: What kind of port it is, so that a trace can wrap it; a screen's pictures are not traced.
        twin: Makes a simulated device from a `gs2ci_sims.world.World` and the settings, or "module:function" of what
            does, so that a real bench does without the simulator. The object's `open()` gives such a port; of the kinds
            "sys", "camera" and "screen", whose devices are opened by calls on the port, it is the port itself. It has
            `plug_in()` and `unplug()`. None: it cannot be simulated. `World.stated` tells what the rig file states of
            the surroundings: the faults to be injected, the [world] table, the line that triggers the sensor. A
            modulator's twin shows its masks by `World.show_mask` and drives its lines on `World.bus`; a stage's has
            `positions_mm_at(when_s)`, the true positions of its axes.
        size: Rows and columns of a modulator, for placing masks on a simulated bench.
        pulse_line: A modulator's trigger line that pulses, behind "modulator." on the simulated bus.
        gate_line: The line that is held while masks are shown, likewise.
        access: What must be permitted for the port, which `gs2ci doctor` examines: a tty, a USB device, a V4L2 node, a
            GenTL producer, a maker's library (`library_file` of the settings), or nothing.
        usb_ids: Vendor and product of a USB device, for its udev rule.
    """

    settings: type[ConfigTable]
    port: Callable[[str, Any], Port]
    driver: Callable[[str, Any, Clock, Any], Modulator | Sensor | Stage]
    port_kind: PortKind = "bytes"
    twin: Callable[[Any, Any], Any] | str | None = None
    size: tuple[int, int] | None = None
    pulse_line: str = "out"
    gate_line: str = "out"
    access: Access = "tty"
    usb_ids: tuple[int, int] | None = None

    def simulated(self, world: Any, settings: Any) -> Any:
        """Make the twin in a world.

        Args:
            world: A `gs2ci_sims.world.World`.
            settings: The device's table.

        Raises:
            PluginError: It has none.
        """
        if self.twin is None:
            raise PluginError(
                f"the plug-in {settings.kind!r} has no twin",
                remedy="use it on a real port, or ask its makers for a twin",
            )
        twin = resolve_name(self.twin) if isinstance(self.twin, str) else self.twin
        return twin(world, settings)


def driver_plugin(group: str, kind: object) -> DriverPlugin | None:
    """Return the driver of a kind, built in or from another package; None if there is none of that name.

    Raises:
        PluginError: The object that a package provides under that name is no driver for this kind.
    """
    if not isinstance(kind, str):
        return None
    if kind in BUILT_IN[group]:
        return _built_in(BUILT_IN[group][kind])
    found = load(group, kind)
    if found is None:
        return None
    if not isinstance(found, DriverPlugin):
        raise PluginError(
            f"the plug-in {kind!r} is {type(found).__name__}", allowed="a gs2ci_drivers.plugin.DriverPlugin"
        )
    field = found.settings.model_fields.get("kind")
    if field is None or get_args(field.annotation) != (kind,) or "port" not in found.settings.model_fields:
        raise PluginError(
            f"the settings of the plug-in {kind!r} do not fit it",
            allowed=f'fields kind: Literal["{kind}"] and port: str',
        )
    return found


def known_driver(group: str, kind: str) -> DriverPlugin:
    """Return the driver of a kind that a rig file was accepted with.

    Raises:
        PluginError: Its package has been removed since, or provides another object.
    """
    found = driver_plugin(group, kind)
    if found is None:
        raise PluginError(
            f"no driver of the kind {kind!r}",
            allowed=", ".join(BUILT_IN[group]),
            remedy="install its package; `gs2ci plugins` lists what is installed",
        )
    return found


@cache
def _built_in(target: str) -> DriverPlugin:
    record = resolve_name(target)
    assert isinstance(record, DriverPlugin)
    return record
