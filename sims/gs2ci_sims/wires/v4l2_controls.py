"""The controls of the V4L2 twin, as in the kernel's control framework.

Integers are rounded into their range, missing menu entries are refused (ERANGE beyond the menu, EINVAL in a hole),
read-only and grabbed controls fail with EACCES and EBUSY. Structures are read and written as plain bytes.

Here: `TwinControl`, `ControlBank`. Not here: the controls that process pictures (`v4l2_processing`), the effect of the
others on the camera (`v4l2_device`).
"""

import ctypes
import struct
from collections.abc import Callable, Iterable
from errno import EACCES, EBUSY, EFAULT, EINVAL, ENOSPC

from gs2ci.core.arrays import U16
from gs2ci_sims.faults import FaultSet, declare
from gs2ci_sims.wires.v4l2_camera import CameraModel
from gs2ci_sims.wires.v4l2_processing import (
    ARRAY,
    BOOLEAN,
    BUTTON,
    CID_ANALOGUE_GAIN,
    CID_AUTOGAIN,
    GRABBED,
    HAS_PAYLOAD,
    INACTIVE,
    INTEGER,
    INTEGER64,
    MENU,
    READ_ONLY,
    WRITE_ONLY,
    TwinControl,
    no_such_value,
    process,
    processing_controls,
)

CONTROL_IGNORED = declare("v4l2.control_ignored", "the camera accepts a control's value and keeps the old one")

NEXT_CONTROL = 0x80000000
WHICH_DEFAULT = 0x0F000000

CID_EXPOSURE = 0x00980911
CID_EXPOSURE_AUTO, CID_EXPOSURE_ABSOLUTE = 0x009A0901, 0x009A0902
CID_VBLANK, CID_HBLANK = 0x009E0901, 0x009E0902
CID_PIXEL_RATE = 0x009F0902
CID_TRIGGER_MODE, CID_SINGLE_TRIGGER, CID_IO_MODE = 0x009819F0, 0x009819F1, 0x009819F2

AUTO_EXPOSURE_S = 1 / 30
MARGIN_LINES = 4
HBLANK_SHARE = 4
"""Horizontal blanking is a quarter of the width."""


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
        self._controls = {control.cid: control for control in sorted(_made(model), key=lambda c: c.cid)}
        self._limit_exposure()

    def __getitem__(self, cid: int) -> int:
        return self._controls[cid].value

    def __contains__(self, cid: int) -> bool:
        return cid in self._controls

    def frame_size(self, height: int, width: int) -> None:
        """Set the frame size, on which the longest exposure depends."""
        self._frame = (height, width)
        if CID_HBLANK in self._controls:
            # The time of a line stays the same: more blanking replaces the columns that are left out.
            line_px = self._model.width + self._model.width // HBLANK_SHARE
            self._controls[CID_HBLANK].value = line_px - width
        self._limit_exposure()

    def exposure_s(self) -> float:
        """Return the exposure that is set, in seconds."""
        if CID_EXPOSURE_AUTO in self._controls and self[CID_EXPOSURE_AUTO] != 1:
            return AUTO_EXPOSURE_S
        if CID_EXPOSURE in self._controls:
            return self[CID_EXPOSURE] * (1e-6 if self._model.exposure == "microseconds" else self._model.line_s)
        return self[CID_EXPOSURE_ABSOLUTE] * 100e-6 if CID_EXPOSURE_ABSOLUTE in self._controls else 5e-3

    def _limit_exposure(self) -> None:
        if self._model.exposure == "lines":
            control = self._controls[CID_EXPOSURE]
            control.high = self._frame[0] + self[CID_VBLANK] - MARGIN_LINES
            control.value = min(control.value, control.high)

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
        if c.inactive_while is not None and self[c.inactive_while]:
            flags |= INACTIVE
        size = 8 if c.kind == INTEGER64 else 4
        elements = 1
        if c.data:
            flags, size = flags | HAS_PAYLOAD, 2 if c.kind == ARRAY else len(c.data)
            elements = len(c.data) // size
        argument[:] = bytes(232)
        struct.pack_into("<II32s", argument, 0, c.cid, c.kind, c.name.encode())
        struct.pack_into("<qqQq", argument, 40, c.low, c.high, c.step, c.default)
        struct.pack_into("<IIII", argument, 72, flags, size, elements, int(c.kind == ARRAY))

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
            control = self._find(cid)
            if control.data:
                self._move(control, payload, 20 * index, write=write, default=which == WHICH_DEFAULT)
                continue
            layout = "<q" if control.kind == INTEGER64 else "<i"
            if write:
                (value,) = struct.unpack_from(layout, payload, 20 * index + 12)
                self._set(control, value)
            elif control.flags & WRITE_ONLY:
                raise no_such_value(EACCES)
            struct.pack_into(layout, payload, 20 * index + 12, control.value)

    def _move(self, control: TwinControl, payload: bytearray, at: int, *, write: bool, default: bool) -> None:
        """Copy an array to or from the memory that the entry points to, as the kernel does.

        Raises:
            OSError: ENOSPC: the memory is too small.
        """
        size, pointer = struct.unpack_from("<I4xQ", payload, at + 4)
        if size < len(control.data):
            raise no_such_value(ENOSPC)
        if not write:
            ctypes.memmove(pointer, control.default_data if default else control.data, len(control.data))
        elif not self._faults.take(CONTROL_IGNORED, control.name):
            control.data = ctypes.string_at(pointer, len(control.data))

    def leave_data(self, name: str, data: bytes) -> None:
        """Set an array as another program does."""
        next(one for one in self._controls.values() if one.name == name).data = data

    def process(self, pixels: U16, top: int) -> U16:
        """Return the readings as the controls that process pictures change them, [H, W]."""
        return process(pixels, top, self._controls)

    def leave(self, name: str, value: int) -> None:
        """Set a control as another program does, unconditionally."""
        next(one for one in self._controls.values() if one.name == name).value = value

    def values(self) -> dict[str, int]:
        """Get all values by name."""
        return {one.name: one.value for one in self._controls.values()}

    def add(self, control: TwinControl) -> None:
        """Give the camera a further control."""
        self._controls = dict(sorted({**self._controls, control.cid: control}.items()))

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
        if control.cid == CID_AUTOGAIN and control.value and not value:
            self._controls[CID_ANALOGUE_GAIN].value = self._model.auto_gain
        if control.kind != BUTTON and not self._faults.take(CONTROL_IGNORED, control.name):
            control.value = value
        if control.cid == CID_VBLANK:
            self._limit_exposure()


def _made(model: CameraModel) -> Iterable[TwinControl]:
    """List the controls that a camera of this model has, with their values at power-up."""
    yield TwinControl(CID_AUTOGAIN, "Gain, Automatic", BOOLEAN, 0, 1, 1, 1)
    yield TwinControl(CID_ANALOGUE_GAIN, "Analogue Gain", INTEGER, 0, 480, 1, 0)
    if model.exposure in ("lines", "microseconds"):
        line_px = model.width + model.width // HBLANK_SHARE
        rate = round(line_px / model.line_s)
        yield TwinControl(CID_VBLANK, "Vertical Blanking", INTEGER, 30, 1_000_000, 1, 30)
        yield TwinControl(CID_HBLANK, "Horizontal Blanking", INTEGER, 0, 100_000, 1, line_px - model.width, READ_ONLY)
        yield TwinControl(CID_PIXEL_RATE, "Pixel Rate", INTEGER64, rate, rate, 1, rate, READ_ONLY)
        longest = model.height if model.exposure == "lines" else 10_000_000
        yield TwinControl(CID_EXPOSURE, "Exposure", INTEGER, 1, longest, 1, 20)
    if model.exposure == "absolute":
        # As in UVC: entries 0 and 2 are holes in the menu, and automatic exposure is on at power-up.
        menu = {1: "Manual Mode", 3: "Aperture Priority Mode"}
        yield TwinControl(CID_EXPOSURE_AUTO, "Auto Exposure", MENU, 0, 3, 1, 3, 0, menu)
        yield TwinControl(CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", INTEGER, 1, 10_000, 1, 157)
    if model.trigger == "control":
        modes = {0: "Disabled", 1: "External", 2: "Pulse Width", 3: "Self", 4: "Single"}
        yield TwinControl(CID_TRIGGER_MODE, "Trigger Mode", MENU, 0, 4, 1, 0, 0, modes)
        yield TwinControl(CID_SINGLE_TRIGGER, "Single Trigger", BUTTON, 0, 0, 0, 0, WRITE_ONLY)
        yield TwinControl(CID_IO_MODE, "IO Mode", INTEGER, 0, 5, 1, 0)
    if model.processing:
        yield from processing_controls()
