"""The controls of the V4L2 twin, as in the kernel's control framework.

Integers are rounded into their range, missing menu entries are refused (ERANGE beyond the menu, EINVAL in a hole),
read-only and grabbed controls fail with EACCES and EBUSY. Structures are read and written as plain bytes.

Here: `TwinControl`, `ControlBank`. Not here: the effect of times and triggers on the camera (`v4l2_device`), controls
that process pictures (`tests/twins/v4l2_processing.py`).
"""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from errno import EACCES, EBUSY, EFAULT, EINVAL, ERANGE

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.v4l2_camera import CameraModel

NEXT_CONTROL = 0x80000000
INTEGER, BOOLEAN, MENU, BUTTON, INTEGER64 = 1, 2, 3, 4, 5
READ_ONLY, WRITE_ONLY, GRABBED = 0x4, 0x40, 0x2

CID_AUTOGAIN, CID_ANALOGUE_GAIN = 0x00980912, 0x009E0903

CID_EXPOSURE = 0x00980911
CID_VBLANK, CID_HBLANK = 0x009E0901, 0x009E0902
CID_PIXEL_RATE = 0x009F0902
CID_TRIGGER_MODE, CID_SINGLE_TRIGGER, CID_IO_MODE = 0x009819F0, 0x009819F1, 0x009819F2

MARGIN_LINES = 4
HBLANK_SHARE = 4
"""Horizontal blanking is a quarter of the width."""


def no_such_value(number: int) -> OSError:
    """Return the error of an ioctl that fails with this errno."""
    return OSError(number, "control")


@dataclass
class TwinControl:
    """One control.

    Args:
        cid: Number.
        name: The kernel's name for it.
        kind: INTEGER, BOOLEAN, MENU, BUTTON or INTEGER64, or another of the kernel's.
        low: Smallest value.
        high: Largest value.
        step: Step of the value.
        value: Present value, at first the default.
        flags: READ_ONLY, WRITE_ONLY or GRABBED.
        menu: Entries of a menu by number.
        default: Its value at power-up.
    """

    cid: int
    name: str
    kind: int
    low: int
    high: int
    step: int
    value: int
    flags: int = 0
    menu: dict[int, str] = field(default_factory=dict)
    default: int = field(init=False)

    def __post_init__(self) -> None:
        self.default = self.value

    def rounded(self, value: int) -> int:
        """Return a value as the framework rounds it.

        Raises:
            OSError: ERANGE or EINVAL for a missing menu entry.
        """
        if self.menu:
            if not self.low <= value <= self.high:
                raise no_such_value(ERANGE)
            if value not in self.menu:
                raise no_such_value(EINVAL)
            return value
        if self.kind == BOOLEAN:
            return int(bool(value))
        step = max(1, self.step)
        steps = (min(max(value, self.low), self.high) - self.low + step // 2) // step
        return self.low + min(steps, (self.high - self.low) // step) * step


class ControlBank:
    """The controls of one camera.

    Args:
        model: The data sheet, which determines the controls.
        faults: The faults to inject.
        grabbed: Returns whether the camera streams, which locks the trigger mode.
    """

    def __init__(self, model: CameraModel, faults: FaultSet, grabbed: Callable[[], bool]) -> None:
        self._model = model
        self._faults = faults
        self._grabbed = grabbed
        self._frame = (model.height, model.width)
        self._controls = {control.cid: control for control in sorted(self._made(), key=lambda c: c.cid)}
        self._limit_exposure()

    def __getitem__(self, cid: int) -> int:
        return self._controls[cid].value

    def __contains__(self, cid: int) -> bool:
        return cid in self._controls

    def frame_size(self, height: int, width: int) -> None:
        """Set the frame size, on which the longest exposure depends."""
        self._frame = (height, width)
        # The time of a line stays the same: more blanking replaces the columns that are left out.
        self._controls[CID_HBLANK].value = self._line_px - width
        self._limit_exposure()

    def exposure_s(self) -> float:
        """Return the exposure that is set, in seconds."""
        return self[CID_EXPOSURE] * self._model.line_s

    def _limit_exposure(self) -> None:
        control = self._controls[CID_EXPOSURE]
        control.high = self._frame[0] + self[CID_VBLANK] - MARGIN_LINES
        control.value = min(control.value, control.high)

    @property
    def _line_px(self) -> int:
        return self._model.width + self._model.width // HBLANK_SHARE

    def query(self, argument: bytearray) -> None:
        """Answer VIDIOC_QUERY_EXT_CTRL.

        Raises:
            OSError: EINVAL: no such control, or no further one.
        """
        (wanted,) = struct.unpack_from("<I", argument, 0)
        if wanted & NEXT_CONTROL:
            later = [cid for cid in self._controls if cid > wanted & 0x3FFFFFFF]
            if not later:
                raise no_such_value(EINVAL)
            wanted = later[0]
        c = self._find(wanted)
        flags = c.flags | (GRABBED if c.cid == CID_TRIGGER_MODE and self._grabbed() else 0)
        argument[:] = bytes(232)
        struct.pack_into("<II32s", argument, 0, c.cid, c.kind, c.name.encode())
        struct.pack_into("<qqQq", argument, 40, c.low, c.high, c.step, c.default)
        struct.pack_into("<IIII", argument, 72, flags, 8 if c.kind == INTEGER64 else 4, 1, 0)

    def query_menu(self, argument: bytearray) -> None:
        """Answer VIDIOC_QUERYMENU.

        Raises:
            OSError: EINVAL: no menu, or no such entry.
        """
        cid, index = struct.unpack_from("<II", argument, 0)
        control = self._find(cid)
        if index not in control.menu:
            raise no_such_value(EINVAL)
        struct.pack_into("<32sI", argument, 8, control.menu[index].encode(), 0)

    def batch(self, argument: bytearray, payload: bytearray | None, *, write: bool) -> None:
        """Answer VIDIOC_G_EXT_CTRLS or VIDIOC_S_EXT_CTRLS.

        Raises:
            OSError: As in the framework; EFAULT for an invalid pointer.
        """
        which, count = struct.unpack_from("<II", argument, 0)
        (pointer,) = struct.unpack_from("<Q", argument, 24)
        if payload is None or not pointer or len(payload) < 20 * count:
            raise no_such_value(EFAULT)
        for index in range(count):
            struct.pack_into("<I", argument, 8, index)
            (cid,) = struct.unpack_from("<I", payload, 20 * index)
            self._exchange(self._find(cid), payload, 20 * index, which, write=write)

    def _exchange(self, control: TwinControl, payload: bytearray, at: int, which: int, *, write: bool) -> None:
        layout = "<q" if control.kind == INTEGER64 else "<i"
        if write:
            (value,) = struct.unpack_from(layout, payload, at + 12)
            self._set(control, value)
        elif control.flags & WRITE_ONLY:
            raise no_such_value(EACCES)
        struct.pack_into(layout, payload, at + 12, control.value)

    def process(self, pixels: U16, top: int) -> U16:
        """Return the readings as gain, in steps of 0.1 dB as imx296's, changes them, [H, W]."""
        gain = 10 ** (self[CID_ANALOGUE_GAIN] * 0.1 / 20)
        return np.minimum(np.rint(pixels * gain), top).astype(np.uint16)

    def leave(self, name: str, value: int) -> None:
        """Set a control as another program does, unconditionally."""
        next(one for one in self._controls.values() if one.name == name).value = value

    def values(self) -> dict[str, int]:
        """Get all values by name."""
        return {one.name: one.value for one in self._controls.values()}

    def _find(self, cid: int) -> TwinControl:
        if cid not in self._controls:
            raise no_such_value(EINVAL)
        return self._controls[cid]

    def _set(self, control: TwinControl, value: int) -> None:
        if control.flags & READ_ONLY:
            raise no_such_value(EACCES)
        if control.cid == CID_TRIGGER_MODE and self._grabbed():
            raise no_such_value(EBUSY)
        value = control.rounded(value)
        if control.kind != BUTTON and not self._faults.take("v4l2.control_ignored", control.name):
            control.value = value
        if control.cid == CID_VBLANK:
            self._limit_exposure()

    def _made(self) -> Iterable[TwinControl]:
        """List the controls that the camera has, with their values at power-up."""
        model = self._model
        rate = round(self._line_px / model.line_s)
        yield TwinControl(CID_AUTOGAIN, "Gain, Automatic", BOOLEAN, 0, 1, 1, 1)
        yield TwinControl(CID_ANALOGUE_GAIN, "Analogue Gain", INTEGER, 0, 480, 1, 0)
        yield TwinControl(CID_VBLANK, "Vertical Blanking", INTEGER, 30, 1_000_000, 1, 30)
        blank_px = self._line_px - model.width
        yield TwinControl(CID_HBLANK, "Horizontal Blanking", INTEGER, 0, 100_000, 1, blank_px, READ_ONLY)
        yield TwinControl(CID_PIXEL_RATE, "Pixel Rate", INTEGER64, rate, rate, 1, rate, READ_ONLY)
        yield TwinControl(CID_EXPOSURE, "Exposure", INTEGER, 1, model.height, 1, 20)
        if model.trigger == "control":
            modes = {0: "Disabled", 1: "External", 2: "Pulse Width", 3: "Self", 4: "Single"}
            yield TwinControl(CID_TRIGGER_MODE, "Trigger Mode", MENU, 0, 4, 1, 0, 0, modes)
            yield TwinControl(CID_SINGLE_TRIGGER, "Single Trigger", BUTTON, 0, 0, 0, 0, WRITE_ONLY)
            yield TwinControl(CID_IO_MODE, "IO Mode", INTEGER, 0, 5, 1, 0)
