"""What a package with a driver of its own provides: the [table] of its settings, its port, its driver, its twin.

Entry points of the groups `gs2ci.modulators`, `gs2ci.sensors` and `gs2ci.stages` are `DriverPlugin`s; `docs/plugins.md`
shows one. Here: the record, and finding one by the `kind` that a rig file names. Not here: opening (`gs2ci.rig`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

from gs2ci.core.clock import Clock
from gs2ci.core.config import ConfigTable
from gs2ci.core.plugins import PluginError, load
from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.ports import BytePort, CameraPort, HidPort, ScreenPort, SysPort
from gs2ci_drivers.sensor import Sensor
from gs2ci_drivers.stage import Stage

Port = BytePort | HidPort | SysPort | CameraPort | ScreenPort
PortKind = Literal["bytes", "hid", "sys", "camera", "screen"]

BUILT_IN: dict[str, tuple[str, ...]] = {
    "gs2ci.modulators": ("dlpc900", "scpi", "santec", "video"),
    "gs2ci.sensors": ("v4l2", "genicam"),
    "gs2ci.stages": ("zaber", "grbl"),
}
"""Kinds that gs2ci opens itself."""


@dataclass(frozen=True)
class DriverPlugin:
    """A driver, built in (`gs2ci.rig.opening.DRIVERS`) or from another package.

    Args:
        settings: The device's table in a rig file: a `ConfigTable` with `kind: Literal["NAME"]`, NAME being the entry
            point's, and `port: str`, for which "simulated" requests the twin. A sensor's or a stage's table also needs
            the fields that the rig reads of the built-in ones: inherit from `V4l2Options` or `ZaberOptions`.
        port: Opens the real port from the device's name and its settings.
        driver: Makes the device from its name, the open port, the clock and the settings. It closes the port.
        port_kind: What kind of port it is, so that a trace can wrap it; a screen's pictures are not traced.
        twin: Makes a simulated device from a `gs2ci_sims.world.World` and the settings: an object whose `open()`
            gives such a port, with `plug_in()` and `unplug()`. None: it cannot be simulated. A modulator's twin shows
            its masks by `World.show_mask` and pulses `modulator.out` on `World.bus`.
        size: Rows and columns of a modulator, for placing masks on a simulated bench.
    """

    settings: type[ConfigTable]
    port: Callable[[str, Any], Port]
    driver: Callable[[str, Any, Clock, Any], Modulator | Sensor | Stage]
    port_kind: PortKind = "bytes"
    twin: Callable[[Any, Any], Any] | None = None
    size: tuple[int, int] | None = None


def driver_plugin(group: str, kind: object) -> DriverPlugin | None:
    """Return the driver of a kind that gs2ci does not open itself; None if no package provides one.

    Raises:
        PluginError: The object that a package provides under that name is no driver for this kind.
    """
    if not isinstance(kind, str) or kind in BUILT_IN[group]:
        return None
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
