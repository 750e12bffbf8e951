"""Controls of a V4L2 node by name and number, and exposure in seconds on top of them.

Here: `ControlTable` (list, read, and set controls, clamping reported) and `ExposureControl` (seconds ↔ lines or
100 µs units). Not here: trigger modes (`trigger`). Imported by `setup`, `trigger` and `driver`.

The V4L2 control framework rounds integers into their range and refuses menu entries that do not exist; some
drivers refuse with ERANGE instead. This module treats both the same.
"""

import ctypes
import difflib
import errno
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from gs2ci_drivers.failures import AccessError, OutOfRangeError, RefusedError, UnsupportedError
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.node import VideoNode, allocate

_MENUS: Final = (abi.ControlType.MENU, abi.ControlType.INTEGER_MENU)
_NUMBERS: Final = (
    abi.ControlType.INTEGER,
    abi.ControlType.BOOLEAN,
    abi.ControlType.BUTTON,
    abi.ControlType.INTEGER64,
    abi.ControlType.BITMASK,
    *_MENUS,
)
_EINVAL: Final = errno.errorcode[errno.EINVAL]
_MAX_CONTROLS: Final = 4096
_FROZEN: Final = abi.ControlFlag.DISABLED | abi.ControlFlag.READ_ONLY

ABSOLUTE_UNIT_S: Final = 100e-6
"""Unit of V4L2_CID_EXPOSURE_ABSOLUTE (V4L2 manual, camera class)."""
VBLANK_MARGIN_LINES: Final = 16
"""Lines left between exposure and frame length when VBLANK is raised; sensors need 4 to 13."""


@dataclass(frozen=True)
class Control:
    """A control as the driver describes it.

    Args:
        cid: Control number.
        name: Lower-case name with underscores, as `v4l2-ctl` writes it.
        kind: How its value is to be read.
        minimum: Smallest value (first menu entry).
        maximum: Largest value (last menu entry; all allowed bits of a bit mask).
        step: Values are minimum + k · step.
        flags: Why it cannot be set, if it cannot.
        menu: Entries of a menu.
    """

    cid: int
    name: str
    kind: abi.ControlType
    minimum: int
    maximum: int
    step: int
    flags: abi.ControlFlag
    menu: dict[int, str] = field(default_factory=dict)

    @property
    def settable(self) -> bool:
        """Get whether a value can be written."""
        return not self.flags & _FROZEN

    @property
    def range_text(self) -> str:
        """Get the allowed values for messages: `1..33 step 1`, or the menu's entries."""
        if self.menu:
            return ", ".join(f"{index} ({entry})" for index, entry in self.menu.items())
        return f"{self.minimum}..{self.maximum} step {self.step}"

    def clamp(self, value: int) -> int:
        """Return the nearest value that the range allows."""
        if self.kind is abi.ControlType.BITMASK:
            return value & self.maximum
        step = max(1, self.step)
        inside = min(max(value, self.minimum), self.maximum)
        on_grid = self.minimum + round((inside - self.minimum) / step) * step
        return on_grid if on_grid <= self.maximum else on_grid - step


@dataclass(frozen=True)
class Applied:
    """The result of setting a control: the requested value, and the value in force."""

    control: str
    requested: int
    applied: int

    @property
    def clamped(self) -> bool:
        """Get whether the device took a value other than the requested one."""
        return self.requested != self.applied


def normal_name(name: str) -> str:
    """Write a control's name as `v4l2-ctl` does: lower case, everything else an underscore."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


class ControlTable:
    """The controls of one node.

    Args:
        node: An open node: the capture node, or the sensor's sub-device.

    Raises:
        DriverError: The node does not answer.
    """

    def __init__(self, node: VideoNode) -> None:
        self._node = node
        self._controls: dict[int, Control] = {}
        self.refresh()

    def __iter__(self) -> Iterator[Control]:
        return iter(self._controls.values())

    def refresh(self) -> None:
        """List the controls again: names and ranges may change with the format, and a list may have been incomplete.

        Raises:
            DriverError: The node does not answer.
        """
        self._controls = {control.cid: control for control in self._enumerate()}

    def _enumerate(self) -> Iterator[Control]:
        cid = 0
        for _ in range(_MAX_CONTROLS):  # a driver whose list never ends must not block the program
            query = self._query(cid | abi.ControlFlag.NEXT_CTRL)
            if query is None or query.id <= cid:
                return
            cid = query.id
            control = self._describe(query)
            if control is not None:
                yield control

    def _query(self, cid: int) -> abi.QueryExtCtrl | None:
        query, raw = allocate(abi.QueryExtCtrl)
        query.id = cid
        try:
            self._node.call(abi.Ioctl.QUERY_EXT_CTRL, raw, "VIDIOC_QUERY_EXT_CTRL")
        except UnsupportedError:  # ENOTTY: no controls at all
            return None
        except RefusedError as error:
            if error.code == _EINVAL:  # no such control, or no further one
                return None
            raise
        return query

    def _describe(self, query: abi.QueryExtCtrl) -> Control | None:
        flags = abi.ControlFlag(query.flags & 0x7FFFFFFF)
        try:
            kind = abi.ControlType(query.type)
        except ValueError:
            return None
        if kind not in _NUMBERS or abi.ControlFlag.DISABLED in flags or query.nr_of_dims:
            return None
        name = normal_name(query.name.decode("utf-8", "replace"))
        menu = self._menu(query) if kind in _MENUS else {}
        return Control(query.id, name, kind, query.minimum, query.maximum, query.step, flags, menu)

    def _menu(self, query: abi.QueryExtCtrl) -> dict[int, str]:
        entries: dict[int, str] = {}
        for index in range(max(0, query.minimum), min(query.maximum, query.minimum + _MAX_CONTROLS) + 1):
            item, raw = allocate(abi.QueryMenu)
            item.id, item.index = query.id, index
            try:
                self._node.call(abi.Ioctl.QUERYMENU, raw, "VIDIOC_QUERYMENU")
            except RefusedError as error:
                if error.code == _EINVAL:  # a hole in the menu
                    continue
                raise
            text = item.u.name.decode("utf-8", "replace")
            entries[index] = str(item.u.value) if query.type == abi.ControlType.INTEGER_MENU else text
        return entries

    def find(self, key: str | int) -> Control | None:
        """Return a control by name (spelt as by `normal_name`) or number, None if there is none."""
        if isinstance(key, int):
            return self._controls.get(key)
        wanted = normal_name(key)
        return next((control for control in self if control.name == wanted), None)

    def require(self, key: str | int) -> Control:
        """Return a control by name or number.

        Raises:
            UnsupportedError: There is none; the message gives the most similar names.
        """
        control = self.find(key)
        if control is None:
            names = [c.name for c in self]
            near = difflib.get_close_matches(normal_name(str(key)), names, 3, 0.5) or names
            raise UnsupportedError(
                self._node.device,
                f"control {key if isinstance(key, str) else hex(key)!r} is not available",
                allowed=", ".join(near) or "none: the node has no controls",
                remedy="see `gs2ci devices`; sensors behind a media controller have theirs on `subdevice`",
            )
        return control

    def get(self, key: str | int) -> int:
        """Read a control's value.

        Raises:
            UnsupportedError: It is not available.
            AccessError: It can only be written.
        """
        control = self.require(key)
        raw, payload, value = self._batch(control, 0)
        self._node.call(abi.Ioctl.G_EXT_CTRLS, raw, f"read control {control.name}", payload)
        return self._value(control, value)

    def set(self, key: str | int, value: int) -> Applied:
        """Set a control to the nearest value that it can take; return the requested and the resulting value.

        Raises:
            UnsupportedError: It is not available.
            AccessError: It is read-only, or another stream holds it (EACCES, EBUSY).
            OutOfRangeError: The value is no entry of a menu, or the driver refuses it although it is in the range.
        """
        control = self._refresh(self.require(key))
        if control.menu and value not in control.menu:
            raise OutOfRangeError(
                self._node.device, f"{control.name} = {value}", asked="set control", allowed=control.range_text
            )
        if not control.settable:
            raise AccessError(self._node.device, f"{control.name} is read-only", asked="set control")
        self._write(control, control.clamp(value))
        if control.flags & abi.ControlFlag.WRITE_ONLY or control.kind is abi.ControlType.BUTTON:
            return Applied(control.name, value, value)
        return Applied(control.name, value, self.get(control.cid))

    def _refresh(self, control: Control) -> Control:
        """Query the range again: that of one control may depend on another (exposure on vertical blanking)."""
        query = self._query(control.cid)
        fresh = self._describe(query) if query is not None else None
        if fresh is None:
            return control
        self._controls[control.cid] = fresh
        return fresh

    def _write(self, control: Control, value: int) -> None:
        asked = f"set control {control.name} = {value}"
        raw, payload, _ = self._batch(control, value)
        try:
            self._node.call(abi.Ioctl.S_EXT_CTRLS, raw, asked, payload)
        except (OutOfRangeError, RefusedError) as error:
            if isinstance(error, RefusedError) and error.code != _EINVAL:
                raise
            raise OutOfRangeError(
                self._node.device, "the driver refuses the value", asked=asked, allowed=control.range_text
            ) from error

    def _batch(self, control: Control, value: int) -> tuple[bytearray, bytearray, abi.ExtControl]:
        entry, payload = allocate(abi.ExtControl)
        entry.id = control.cid
        if control.kind is abi.ControlType.INTEGER64:
            entry.u.value64 = value
        else:
            entry.u.value = value
        batch, raw = allocate(abi.ExtControls)
        batch.which, batch.count = abi.CTRL_WHICH_CUR_VAL, 1
        batch.controls = ctypes.addressof(entry)
        return raw, payload, entry

    def _value(self, control: Control, entry: abi.ExtControl) -> int:
        if control.kind is abi.ControlType.INTEGER64:
            return int(entry.u.value64)
        if control.kind is abi.ControlType.BITMASK:
            return int(entry.u.value) & 0xFFFFFFFF
        return int(entry.u.value)


class ExposureControl:
    """Exposure in seconds, through the control that the sensor has for it.

    Args:
        table: Where the controls are.
        control: EXPOSURE or EXPOSURE_ABSOLUTE.
        unit_s: Seconds per unit of the control.
    """

    def __init__(self, table: ControlTable, control: Control, unit_s: float) -> None:
        self._table = table
        self._control = control
        self.unit_s = unit_s

    @classmethod
    def find(cls, table: ControlTable, width: int, unit_s: float | None = None) -> "ExposureControl | None":
        """Return the finest exposure control whose unit is known, or None.

        Args:
            table: Where the controls are.
            width: Columns, for the line time (width + HBLANK) / PIXEL_RATE.
            unit_s: Seconds per unit of EXPOSURE from the user; None to take the driver's figures.
        """
        lines, absolute = table.find(abi.Cid.EXPOSURE), table.find(abi.Cid.EXPOSURE_ABSOLUTE)
        unit_s = unit_s or line_time_s(table, width)
        if lines is not None and lines.settable and unit_s is not None:
            return cls(table, lines, unit_s)
        if absolute is not None and absolute.settable:
            return cls(table, absolute, ABSOLUTE_UNIT_S)
        return None

    @property
    def min_s(self) -> float:
        """Get the shortest exposure in seconds."""
        return self._control.minimum * self.unit_s

    @property
    def step_s(self) -> float:
        """Get the granularity in seconds."""
        return max(1, self._control.step) * self.unit_s

    @property
    def max_s(self) -> float:
        """Get the longest exposure in seconds, with longer frames if VBLANK can be set."""
        return (self._control.maximum + self._spare_lines()) * self.unit_s

    def _spare_lines(self) -> int:
        vblank = self._vblank()
        if vblank is None:
            return 0
        return max(0, vblank.maximum - self._table.get(vblank.cid))

    def _vblank(self) -> Control | None:
        """Return VBLANK if raising it allows longer exposures, that is, if exposure is counted in lines."""
        vblank = self._table.find(abi.Cid.VBLANK)
        in_lines = self._control.cid == abi.Cid.EXPOSURE
        return vblank if in_lines and vblank is not None and vblank.settable else None

    def set_s(self, exposure_s: float) -> float:
        """Set the exposure; return the one in force, quantised and clamped by the device.

        Raises:
            DriverError: The controls cannot be set.
        """
        units = round(exposure_s / self.unit_s)
        missing = units - self._control.maximum
        vblank = self._vblank()
        if missing > 0 and vblank is not None:
            self._table.set(vblank.cid, self._table.get(vblank.cid) + missing + VBLANK_MARGIN_LINES)
        applied = self._table.set(self._control.cid, units).applied
        self._control = self._table.require(self._control.cid)
        return applied * self.unit_s


def line_time_s(table: ControlTable, width: int) -> float | None:
    """Compute a line's duration, (width + HBLANK) / PIXEL_RATE, in seconds; None if the driver reports neither."""
    hblank, rate = table.find(abi.Cid.HBLANK), table.find(abi.Cid.PIXEL_RATE)
    if hblank is None or rate is None:
        return None
    pixels_per_s = table.get(rate.cid)
    return (width + table.get(hblank.cid)) / pixels_per_s if pixels_per_s > 0 else None
