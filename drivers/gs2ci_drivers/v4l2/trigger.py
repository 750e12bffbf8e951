"""External triggers: V4L2 has no standard control for them, so each kind of kernel driver gets an adapter.

    ModuleTrigger    /sys/module/<module>/parameters/trigger_mode      imx296, imx477, ov7251, ar0234 ...
    ControlTrigger   a private control found by its name               VC-MIPI drivers and similar ones
    OutsideTrigger   switched by other means before (hidraw, I2C, device tree); `gs2ci doctor` proves it
    NoTrigger        free run only

Here: switching modes and restoring the one that was found. Not here: what a mode means (`sensor.TriggerMode`).
Imported by `setup`.
"""

import errno
from collections.abc import Mapping
from typing import Final, NoReturn, Protocol

from gs2ci.core.clock import Clock
from gs2ci.core.errors import reason_of
from gs2ci_drivers.failures import AccessError, UnsupportedError
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.sensor import TriggerMode
from gs2ci_drivers.v4l2.controls import ControlTable
from gs2ci_drivers.v4l2.node import raise_typed
from gs2ci_drivers.v4l2.options import V4l2Options

PULSE_WIDTH_OFFSETS_S: Final = {"imx296": 14.26e-6}
"""Modules whose exposure is the width of the trigger pulse plus this constant; the others take an edge."""
MODULE_VALUES: Final[Mapping[str, int]] = {"imx296": 1, "imx477": 2, "ar0234": 1, "ov7251": 1}
"""What a module's parameter `trigger_mode` must be for external triggers.

imx296.c "0=default, 1=XTRIG", imx477.c "1=source, 2=sink" (imx477.c also drives the IMX378), ar0234.c "0=off,
1=external-trigger, 2=sync-sink" (MODULE_PARM_DESC of each, raspberrypi/linux). As a source a sensor runs by its own
clock and drives the line."""
TREES: Final = "/sys/bus/i2c/drivers/{module}/*/of_node/trigger-mode"
"""The device tree's own setting, which overrides the parameter (imx477_probe and ar0234_probe: `trigger_mode_of`)."""


class TriggerAdapter(Protocol):
    """A way to switch a sensor between its own clock and external triggers."""

    triggers: frozenset[TriggerMode]
    exposure_offset_s: float
    controls: frozenset[int]
    """Numbers of the controls that it sets."""

    def recorded(self) -> dict[str, int | str]:
        """Return the trigger's setting that is no control, for the shot file."""
        ...

    def set_mode(self, mode: TriggerMode) -> None:
        """Switch; call it only while the sensor does not stream."""
        ...

    def restore(self) -> None:
        """Put back what was found before the first switch."""
        ...


class NoTrigger:
    """A sensor that runs only by its own clock."""

    triggers = frozenset({TriggerMode.FREE_RUN})
    exposure_offset_s = 0.0
    controls: frozenset[int] = frozenset()

    def recorded(self) -> dict[str, int | str]:
        """Return nothing: there is no setting."""
        return {}

    def set_mode(self, mode: TriggerMode) -> None:
        """Do nothing: there is one mode."""

    def restore(self) -> None:
        """Do nothing: nothing was changed."""


class OutsideTrigger(NoTrigger):
    """A sensor that other means have switched to external triggers, and that cannot be switched from here.

    Args:
        mode: What they have switched it to.
    """

    def __init__(self, mode: TriggerMode) -> None:
        self.triggers = frozenset({mode})
        self._mode = mode

    def recorded(self) -> dict[str, int | str]:
        """Return the mode that the rig file states."""
        return {"trigger, set outside": self._mode.value}


class ModuleTrigger:
    """A kernel module's parameter `trigger_mode`: 0 own clock, another number external; see `MODULE_VALUES`.

    The driver reads the parameter when the sensor powers up, so after a change this class waits until the sensor has
    powered down.

    Args:
        port: The system calls.
        clock: The clock of the wait for the power-down.
        device: Name of the sensor for messages.
        module: The kernel module.
        power_down_s: How long an idle sensor takes to power down.
        values: The parameter's number for each mode; {} takes the module's known ones.

    Raises:
        UnsupportedError: The module is not loaded, its numbers are not known, or the device tree overrides them.
        AccessError: The parameter may not be read.
    """

    controls: frozenset[int] = frozenset()

    def __init__(
        self,
        port: SysPort,
        clock: Clock,
        device: str,
        module: str,
        power_down_s: float,
        values: Mapping[TriggerMode, int],
    ) -> None:
        self._port = port
        self._clock = clock
        self._device = device
        self._module = module
        self._path = f"/sys/module/{module}/parameters/trigger_mode"
        self._power_down_s = power_down_s
        self._found: bytes | None = None
        self._values: dict[TriggerMode, int] = {}
        self._read()
        self._values = dict(values) or self._known_values()
        self.triggers = frozenset(self._values)
        self.exposure_offset_s = PULSE_WIDTH_OFFSETS_S.get(module, 0.0)
        self._require_no_tree()

    def recorded(self) -> dict[str, int | str]:
        """Return the parameter's value."""
        return {f"{self._module}.trigger_mode": self._read().decode("ascii", "replace")}

    def _known_values(self) -> dict[TriggerMode, int]:
        if self._module not in MODULE_VALUES:
            raise UnsupportedError(
                self._device,
                f"the numbers of {self._path} are not known",
                asked="find the trigger",
                allowed=f"known modules: {', '.join(sorted(MODULE_VALUES))}",
                remedy="set trigger_values in [sensor] from `modinfo -p` of the module and its documentation",
            )
        external = TriggerMode.LEVEL if self._module in PULSE_WIDTH_OFFSETS_S else TriggerMode.EDGE
        return {TriggerMode.FREE_RUN: 0, external: MODULE_VALUES[self._module]}

    def _require_no_tree(self) -> None:
        """Refuse a device tree that fixes another mode than the parameter's: the parameter then has no effect."""
        for path in self._port.list_nodes(TREES.format(module=self._module)):
            fixed = int.from_bytes(self._port.read_file(path), "big")
            modes = frozenset(mode for mode, value in self._values.items() if value == fixed)
            if not modes or modes == {TriggerMode.FREE_RUN}:
                raise UnsupportedError(
                    self._device,
                    f"the device tree fixes trigger-mode = {fixed} for {self._module}: its parameter has no effect",
                    asked="find the trigger",
                    allowed=f"no trigger-mode there, or one of {sorted(self._values.values())}",
                    remedy=f"remove `trigger-mode` from the sensor's dtoverlay line and restart ({path})",
                )
            self.triggers = modes  # it can be used, but not switched

    def set_mode(self, mode: TriggerMode) -> None:
        """Write the parameter and, if its value changed, wait until the sensor has powered down.

        Raises:
            AccessError: The parameter may not be written.
            UnsupportedError: The module is not loaded, or did not accept the value.
        """
        if self._write(str(self._values[mode]).encode()):
            self._clock.sleep_s(self._power_down_s)

    def restore(self) -> None:
        """Write the value that was found before the first switch.

        Raises:
            AccessError, UnsupportedError: As `set_mode`.
        """
        if self._found is not None:
            self._write(self._found)
            self._found = None

    def _write(self, value: bytes) -> bool:
        before = self._read()
        if before == value:
            return False
        self._found = before if self._found is None else self._found
        try:
            self._port.write_file(self._path, value + b"\n")
        except OSError as error:
            self._fail(error)
        now = self._read()
        if now != value:
            raise UnsupportedError(
                self._device,
                f"{self._path} reads {now!r} after {value!r} was written",
                asked="switch the trigger",
                remedy="this module's trigger works differently; see its documentation",
            )
        return True

    def _read(self) -> bytes:
        try:
            value = self._port.read_file(self._path).strip()
        except OSError as error:
            self._fail(error)
        return {b"Y": b"1", b"N": b"0"}.get(value, value)  # the kernel prints bool parameters as Y and N

    def _fail(self, error: OSError) -> NoReturn:
        asked = f"access {self._path}"
        if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            raise AccessError(
                self._device,
                f"no permission ({reason_of(error)})",
                asked=asked,
                remedy=f"write `options {self._module} trigger_mode={max(self._values.values(), default=1)}` to "
                f"/etc/modprobe.d/{self._module}.conf and "
                "load the module again, or install the rule that `gs2ci doctor` prints",
            ) from error
        if error.errno in (errno.ENOENT, errno.ENOTDIR):
            raise UnsupportedError(
                self._device,
                f"module {self._module!r} is not loaded or has no parameter trigger_mode",
                asked=asked,
                remedy="set trigger_module in [sensor] to the sensor's kernel module; where the device tree alone "
                'switches the sensor (dtoverlay=ov9281,trigger-mode=1), set trigger_adapter = "outside"',
            ) from error
        raise_typed(self._device, asked, error)


VC_VALUES: Final[Mapping[TriggerMode, int]] = {
    TriggerMode.FREE_RUN: 0,
    TriggerMode.EDGE: 1,
    TriggerMode.LEVEL: 2,
}
"""The numbers of the VC-MIPI drivers' control (vc_mipi_core.c, vc_mod_set_trigger_mode). Of others, which have no
"single_trigger", only the first two are taken: VEYE's 2 is an edge, too ("high-speed continuous trigger mode")."""
_COMMON: Final = (TriggerMode.FREE_RUN, TriggerMode.EDGE)


class ControlTrigger:
    """A private control, found by its name.

    Args:
        table: The controls of the node that has it.
        device: Name of the sensor for messages.
        options: Name of the control and its value for each mode.

    Raises:
        UnsupportedError: The control does not exist, or has none of the values.
    """

    def __init__(self, table: ControlTable, device: str, options: V4l2Options) -> None:
        self._table = table
        known = VC_VALUES if table.find("single_trigger") else {mode: VC_VALUES[mode] for mode in _COMMON}
        self._values = dict(options.trigger_values) or known
        self._found: int | None = None
        control = table.require(options.trigger_control)
        self._cid = control.cid
        self.controls = frozenset({control.cid})
        there = control.menu or range(control.minimum, control.maximum + 1)
        self.triggers = frozenset(mode for mode, value in self._values.items() if value in there)
        self.exposure_offset_s = 0.0
        if not self.triggers:
            raise UnsupportedError(
                device,
                f"control {control.name} has none of the values {sorted(self._values.values())}",
                asked="find the trigger",
                allowed=control.range_text,
                remedy="set trigger_values in [sensor] from the camera's documentation",
            )

    def recorded(self) -> dict[str, int | str]:
        """Return nothing: its control is recorded with the others."""
        return {}

    def set_mode(self, mode: TriggerMode) -> None:
        """Set the control.

        Raises:
            DriverError: The control cannot be set.
        """
        if self._found is None:
            self._found = self._table.get(self._cid)
        self._table.set(self._cid, self._values[mode])

    def restore(self) -> None:
        """Set the value that was found before the first switch.

        Raises:
            DriverError: The control cannot be set.
        """
        if self._found is not None:
            found, self._found = self._found, None
            self._table.set(self._cid, found)


def trigger_adapter(
    port: SysPort, clock: Clock, device: str, table: ControlTable, options: V4l2Options
) -> TriggerAdapter:
    """Return the adapter that the options name.

    Raises:
        UnsupportedError: The kernel module or the control is not there.
        AccessError: The module's parameter may not be read.
    """
    if options.trigger_adapter == "module":
        module, values = options.trigger_module, options.trigger_values
        return ModuleTrigger(port, clock, device, module, options.power_down_s, values)
    if options.trigger_adapter == "outside":
        return OutsideTrigger(TriggerMode(options.outside_trigger))
    if options.trigger_adapter == "control":
        return ControlTrigger(table, device, options)
    return NoTrigger()
