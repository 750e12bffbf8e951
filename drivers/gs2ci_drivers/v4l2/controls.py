"""Controls of a V4L2 node by name and number.

Here: `ControlTable` (list, read, and set controls, clamping reported). Not here: exposure in seconds (`exposure`), what
other programs left set (`leftovers`), trigger modes (`trigger`).

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

from gs2ci_drivers.failures import (
    AccessError,
    DisconnectedError,
    DriverError,
    OutOfRangeError,
    UnsupportedError,
)
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
_MAX_CONTROLS: Final = 4096
_FROZEN: Final = abi.ControlFlag.DISABLED | abi.ControlFlag.READ_ONLY


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
        default: Its value at power-up, by the driver.
    """

    cid: int
    name: str
    kind: abi.ControlType
    minimum: int
    maximum: int
    step: int
    flags: abi.ControlFlag
    menu: dict[int, str] = field(default_factory=dict)
    default: int = 0

    @property
    def has_value(self) -> bool:
        """Get whether it has a value that can be read."""
        return not self.flags & abi.ControlFlag.WRITE_ONLY and self.kind is not abi.ControlType.BUTTON

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
        self.tables: dict[int, str] = {}
        """Names of the arrays and structures that can be set, by number: they are neither read nor written here."""
        self.refresh()

    def __iter__(self) -> Iterator[Control]:
        return iter(self._controls.values())

    def refresh(self) -> None:
        """List the controls again: names and ranges may change with the format, and a list may have been incomplete.

        Raises:
            DriverError: The node does not answer.
        """
        self.tables = {}
        self._controls = {control.cid: control for control in self._enumerate()}

    def _enumerate(self) -> Iterator[Control]:
        cid = 0
        for _ in range(_MAX_CONTROLS):  # a driver whose list never ends must not block the program
            query = self._query(cid | abi.ControlFlag.NEXT_CTRL | abi.ControlFlag.NEXT_COMPOUND)
            if query is None or query.id <= cid:
                return
            cid = query.id
            control = self._describe(query)
            if control is not None:
                yield control
            elif query.flags & abi.ControlFlag.HAS_PAYLOAD and not query.flags & _FROZEN:
                self.tables[cid] = normal_name(query.name.decode("utf-8", "replace"))

    def _query(self, cid: int) -> abi.QueryExtCtrl | None:
        query, raw = allocate(abi.QueryExtCtrl)
        query.id = cid
        # ENOTTY: no controls at all; EINVAL: no such control, or no further one.
        missing = (errno.ENOTTY, errno.EINVAL)
        return (
            query if self._node.call(abi.Ioctl.QUERY_EXT_CTRL, raw, "VIDIOC_QUERY_EXT_CTRL", unless=missing) else None
        )

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
        limits = query.minimum, query.maximum, query.step
        return Control(query.id, name, kind, *limits, flags, menu, query.default_value)

    def _menu(self, query: abi.QueryExtCtrl) -> dict[int, str]:
        entries: dict[int, str] = {}
        for index in range(max(0, query.minimum), min(query.maximum, query.minimum + _MAX_CONTROLS) + 1):
            item, raw = allocate(abi.QueryMenu)
            item.id, item.index = query.id, index
            if not self._node.call(abi.Ioctl.QUERYMENU, raw, "VIDIOC_QUERYMENU", unless=(errno.EINVAL,)):
                continue  # a hole in the menu
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

    def values(self) -> dict[str, int | str]:
        """Read all values, by name; for one that the driver refuses to tell, the reason.

        Raises:
            DisconnectedError: The camera is gone.
        """
        found: dict[str, int | str] = {}
        for control in self:
            if control.has_value:
                try:
                    found[control.name] = self.get(control.cid)
                except DisconnectedError:
                    raise
                except DriverError as error:
                    found[control.name] = f"not readable: {error.problem}"
        return found

    def set(self, key: str | int, value: int) -> Applied:
        """Set a control to the nearest value that it can take; return the requested and the resulting value.

        Raises:
            UnsupportedError: It is not available.
            AccessError: It is read-only, or another stream holds it (EACCES, EBUSY).
            OutOfRangeError: The value is no entry of a menu, or the driver refuses it although it is in the range.
        """
        control = self.renewed(self.require(key))
        if control.menu and value not in control.menu:
            raise OutOfRangeError(
                self._node.device, f"{control.name} = {value}", asked="set control", allowed=control.range_text
            )
        if not control.settable:
            raise AccessError(self._node.device, f"{control.name} is read-only", asked="set control")
        self._write(control, control.clamp(value))
        if not control.has_value:
            return Applied(control.name, value, value)
        return Applied(control.name, value, self.get(control.cid))

    def renewed(self, control: Control) -> Control:
        """Query the range again: that of one control may depend on another (exposure on vertical blanking).

        Raises:
            DriverError: The node does not answer.
        """
        query = self._query(control.cid)
        fresh = self._describe(query) if query is not None else None
        if fresh is None:
            return control
        self._controls[control.cid] = fresh
        return fresh

    def _write(self, control: Control, value: int) -> None:
        asked = f"set control {control.name} = {value}"
        raw, payload, _ = self._batch(control, value)
        if not self._node.call(abi.Ioctl.S_EXT_CTRLS, raw, asked, payload, unless=(errno.ERANGE, errno.EINVAL)):
            raise OutOfRangeError(
                self._node.device, "the driver refuses the value", asked=asked, allowed=control.range_text
            )

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
