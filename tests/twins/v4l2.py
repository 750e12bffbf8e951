"""V4L2 cameras that differ from the usual one of the simulated bench: in formats, planes, exposures, controls, stamps.

Here: `CameraModel`, `V4l2Twin` as those of `gs2ci_sims.wires`, with what a rig file cannot state. Not here: processing
(`v4l2_processing`).
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from errno import EFAULT, ENOTTY
from typing import Literal

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci_sims.wires import v4l2, v4l2_camera
from gs2ci_sims.wires.shutter import Exposed, Shutting
from gs2ci_sims.wires.v4l2_camera import BITS, FIVE_FOURTHS, ONE, PADDING_BYTE, THREE_HALVES, row_bytes
from gs2ci_sims.wires.v4l2_controls import (
    CID_ANALOGUE_GAIN,
    CID_AUTOGAIN,
    CID_EXPOSURE,
    CID_HBLANK,
    CID_PIXEL_RATE,
    CID_VBLANK,
    INTEGER,
    INTEGER64,
    MENU,
    NEXT_CONTROL,
    ControlBank,
)
from gs2ci_sims.wires.v4l2_controls import TwinControl as PlainControl
from gs2ci_sims.wires.v4l2_device import CaptureDevice, OpenFile
from gs2ci_sims.wires.v4l2_queue import FLAG_ERROR, FLAG_MONOTONIC, BufferRing, Filled, _Slot
from tests.twins.shutter import OddShutter
from tests.twins.v4l2_processing import ARRAY, HAS_PAYLOAD, INACTIVE, TwinControl, process, processing_controls

CAP_CAPTURE_MULTI, MULTI = 0x1000, 9
CID_EXPOSURE_AUTO, CID_EXPOSURE_ABSOLUTE = 0x009A0901, 0x009A0902
CID_TEGRA_GAIN, CID_TEGRA_EXPOSURE, CID_TEGRA_RATE, CID_OVERRIDE = 0x009A2009, 0x009A200A, 0x009A200B, 0x009A2065
INTEGER_MENU = 9
AUTO_EXPOSURE_S = 1 / 30
TABLE_EXPOSURE_S, TEGRA_MARGIN_S = 2495e-6, 75e-6
"""The exposure of NVIDIA's mode tables, and four lines of an imx219 (nv_imx219.c: IMX219_MAX_COARSE_DIFF)."""


@dataclass(frozen=True)
class CameraModel(v4l2_camera.CameraModel):
    """A camera's data sheet; further arguments as for the usual one.

    Args:
        significant_bits: Bits of the converter if they are fewer than the format's; 0 for the format's.
        left_aligned: Whether 16-bit containers carry the value in their upper bits.
        repeats_top: Whether its top bits are repeated below it then, as by VI5 of NVIDIA's Jetson Xavier and Orin
            (T_R16; https://forums.developer.nvidia.com/t/223616).
        compact: Whether values of a 16-bit container lie one after another instead, the first in the lowest bits, in
            rows of a multiple of 256 bytes, as Rockchip's rkcif puts them into memory unless told otherwise
            (CSI_LVDS_MEM_COMPACT, "8bit memory compact"; wiki of VEYE's cameras on the RK3588, Line stride).
        stride_multiple: Rows are padded to a multiple of this number of bytes.
        multi_plane: Whether it captures through the multi-plane interface, with a header before each plane.
        header_bytes: Header before the pixels of a plane (multi-plane only).
        max_buffers: Most buffers that the kernel gives.
        exposure: Its exposure control: in lines, in microseconds although line times are reported (vc_mipi_camera.c,
            vc_sd_s_ctrl, unless the device tree has the property `libcamera`), in units of 100 µs, by NVIDIA's own
            controls (theimagingsource.com, Configuring Sensor Settings: TEGRA_CAMERA_CID_EXPOSURE, integer64, µs;
            alexian79's imx219 on a Jetson Nano, as v4l2-ctl lists its frame rate: 2000000 to 21000000), or none. A
            start sends NVIDIA's only while override_enable is on (tegracam_v4l2.c, v4l2sd_stream), and the frame's
            lines end an exposure, whatever the control says (nv_imx219.c, imx219_set_exposure).
        rate_units: Units of NVIDIA's frame rate to a hertz: 1000 in VC MIPI's device trees.
        tree_trigger: The device tree's `trigger-mode`, which overrides the parameter (imx477_probe: trigger_mode_of).
        tree_known: Whether the device tree of the sensor is below /sys/bus/i2c, as on a Raspberry Pi.
        ignored_triggers: Edges lost after each start.
        monotonic: Whether stamps count on CLOCK_MONOTONIC.
        ahead_s: By how much they lead CLOCK_MONOTONIC, although they are flagged as its: `REALTIME_S` by uvcvideo with
            clock=realtime (uvc_video_get_time in uvc_video.c; uvc_queue_init sets the flag in any case), 29 s on a
            Jetson Xavier (vi5_fops.c, vi5_capture_dequeue; forums.developer.nvidia.com/t/265011).
        restarts_numbers: Whether frame numbers restart with each start.
        first_number: The first of them: unicam's is 1 (kbingham/libcamera issue 50).
        has_events: Whether source changes can be subscribed to.
        processing: Whether it has further controls that change readings (`v4l2_processing`).
        gamma: Its gamma at power-up, in hundredths: "typically 100 (gamma = 1) or 220 (gamma = 2.2)" of USB cameras
            (Microsoft, KSPROPERTY_VIDEOPROCAMP_GAMMA).
        sensor: Kernel driver of the sensor, which the kernel lists below /sys/bus/i2c; "": it lists none.
        auto_gain: Where automatic gain stands while it is on; it stays there when it is switched off.
        gives_up_s: After how long without a frame it gives a buffer back, marked as bad; 0: never. NVIDIA's waits for
            2.5 s (vi5_fops.c: vi5_capture_dequeue, CAPTURE_TIMEOUT_MS).
        blanks: Whether its lines can be stretched (imx219.c, imx477.c: V4L2_CID_HBLANK), as libcamera does for long
            exposures: an exposure of as many lines lasts longer then.
        bus_code: The only bus format of its sensor, which its receiver widens to 16 bits; 0: one for each format.
    """

    significant_bits: int = 0
    left_aligned: bool = False
    repeats_top: bool = False
    compact: bool = False
    stride_multiple: int = 1
    multi_plane: bool = False
    header_bytes: int = 0
    max_buffers: int = 32
    exposure: Literal["lines", "microseconds", "absolute", "tegra", "none"] = "lines"
    rate_units: int = 1_000_000
    tree_trigger: int | None = None
    tree_known: bool = True
    ignored_triggers: int = 0
    monotonic: bool = True
    ahead_s: float = 0.0
    restarts_numbers: bool = True
    first_number: int = 0
    has_events: bool = True
    processing: bool = False
    gamma: int = 100
    sensor: str = ""
    auto_gain: int = 0
    gives_up_s: float = 0.0
    blanks: bool = False
    bus_code: int = 0

    @property
    def files(self) -> dict[str, bytes]:
        """Get what the kernel shows of the sensor, file by file; of its device tree, a number is big-endian."""
        if self.sensor:
            return {f"/sys/bus/i2c/drivers/{self.sensor}/10-0010": b""}
        found = super().files if self.tree_known else {}
        if found and self.trigger == "module" and self.tree_trigger is not None:
            node = f"/sys/bus/i2c/drivers/{self.module}/10-001a/of_node"
            return found | {f"{node}/trigger-mode": self.tree_trigger.to_bytes(4, "big")}
        return {path: data for path, data in found.items() if self.exposure == "lines" or "libcamera" not in path}

    def module_mode(self, value: int) -> Shutting:
        """Return what a number of the module's parameter switches on; the device tree's takes precedence."""
        return super().module_mode(value if self.tree_trigger is None else self.tree_trigger)

    def bits(self, code: str) -> int:
        return min(self.significant_bits or BITS[code], BITS[code])

    def stride(self, code: str, width: int) -> int:
        if self.compact and code not in (*ONE, *FIVE_FOURTHS, *THREE_HALVES):
            return -(-width * BITS[code] // 8 // 256) * 256
        return -(-row_bytes(code, width) // self.stride_multiple) * self.stride_multiple


class OddBank(ControlBank):
    """Controls with arrays, switches that others depend on, and exposures in other units."""

    _model: CameraModel

    def add(self, control: PlainControl) -> None:
        """Give the camera a further control."""
        self._controls = dict(sorted({**self._controls, control.cid: control}.items()))

    def frame_size(self, height: int, width: int) -> None:
        if CID_HBLANK in self:
            super().frame_size(height, width)

    def exposure_s(self) -> float:
        if CID_EXPOSURE_AUTO in self and self[CID_EXPOSURE_AUTO] != 1:
            return AUTO_EXPOSURE_S
        if CID_OVERRIDE in self:
            frame_s = self._model.rate_units / self[CID_TEGRA_RATE]
            overridden_s = min(self[CID_TEGRA_EXPOSURE] * 1e-6, frame_s - TEGRA_MARGIN_S)
            return overridden_s if self[CID_OVERRIDE] else TABLE_EXPOSURE_S
        if CID_EXPOSURE in self:
            line_px = self._frame[1] + self[CID_HBLANK] if self._model.blanks else self._line_px
            lines_s = super().exposure_s() * line_px / self._line_px
            return self[CID_EXPOSURE] * 1e-6 if self._model.exposure == "microseconds" else lines_s
        return self[CID_EXPOSURE_ABSOLUTE] * 100e-6 if CID_EXPOSURE_ABSOLUTE in self else 5e-3

    def _limit_exposure(self) -> None:
        if self._model.exposure == "lines":
            super()._limit_exposure()

    def process(self, pixels: U16, top: int) -> U16:
        return process(pixels, top, self._controls)

    def query(self, argument: bytearray) -> None:
        super().query(argument)
        control = self._find(struct.unpack_from("<I", argument)[0] & ~NEXT_CONTROL)
        if not isinstance(control, TwinControl):
            return
        flags, size, elements, dimensions = struct.unpack_from("<IIII", argument, 72)
        if control.kind == ARRAY:
            flags, size, elements, dimensions = flags | HAS_PAYLOAD, 2, 32, 1
        if control.inactive_while is not None and self[control.inactive_while]:
            flags |= INACTIVE
        struct.pack_into("<IIII", argument, 72, flags, size, elements, dimensions)

    def query_menu(self, argument: bytearray) -> None:
        super().query_menu(argument)
        cid, index = struct.unpack_from("<II", argument, 0)
        if self._find(cid).kind == INTEGER_MENU:
            struct.pack_into("<q24x", argument, 8, int(self._find(cid).menu[index]))

    def _set(self, control: PlainControl, value: int) -> None:
        if control.cid == CID_AUTOGAIN and control.value and not control.rounded(value):
            self._controls[CID_ANALOGUE_GAIN].value = self._model.auto_gain
        super()._set(control, value)

    def _made(self) -> Iterable[PlainControl]:
        model = self._model
        in_lines = (CID_VBLANK, CID_HBLANK, CID_PIXEL_RATE, CID_EXPOSURE)
        for control in super()._made():
            if control.cid == CID_HBLANK and model.blanks:
                control.flags = 0
            if control.cid == CID_EXPOSURE and model.exposure == "microseconds":
                control.high = 10_000_000
            if model.exposure == "tegra" and control.cid in (CID_AUTOGAIN, CID_ANALOGUE_GAIN):
                continue
            if control.cid not in in_lines or model.exposure in ("lines", "microseconds"):
                yield control
        if model.exposure == "absolute":
            # As in UVC: entries 0 and 2 are holes in the menu, and automatic exposure is on at power-up.
            menu = {1: "Manual Mode", 3: "Aperture Priority Mode"}
            yield TwinControl(CID_EXPOSURE_AUTO, "Auto Exposure", MENU, 0, 3, 1, 3, 0, menu)
            yield TwinControl(CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", INTEGER, 1, 10_000, 1, 157)
        if model.exposure == "tegra":
            yield TwinControl(CID_TEGRA_GAIN, "Gain", INTEGER64, 16, 170, 1, 16)
            yield TwinControl(CID_TEGRA_EXPOSURE, "Exposure", INTEGER64, 13, 683_709, 1, 2495)
            rates = (2 * model.rate_units, 21 * model.rate_units, 1, 21 * model.rate_units)
            yield TwinControl(CID_TEGRA_RATE, "Frame Rate", INTEGER64, *rates)
            yield TwinControl(CID_OVERRIDE, "Override Enable", INTEGER_MENU, 0, 1, 1, 0, 0, {0: "0", 1: "1"})
        if model.processing:
            yield from processing_controls(model.gamma)


class OddRing(BufferRing):
    """Buffers of one plane each, behind the multi-plane interface."""

    header_bytes = 0

    def _write(self, argument: bytearray, payload: bytearray | None, index: int, slot: _Slot) -> None:
        """Write struct v4l2_buffer, and struct v4l2_plane behind its pointer."""
        planes, count = struct.unpack_from("<QI", argument, 64)
        super()._write(argument, payload, index, slot)
        if self.kind != MULTI:
            return
        offset, length = struct.unpack_from("<QI", argument, 64)
        if not planes or not count or payload is None or len(payload) < 64:
            raise OSError(EFAULT, "planes")
        filled = slot.filled or Filled(0, 0, 0, 0)
        struct.pack_into("<I", argument, 8, 0)
        struct.pack_into("<QI", argument, 64, planes, 1)
        struct.pack_into("<IIQI", payload, 0, filled.bytes_used, length, offset, self.header_bytes)

    def request(self, argument: bytearray, size_bytes: int, most: int) -> None:
        super().request(argument, size_bytes + self.header_bytes, most)


class OddDevice(CaptureDevice):
    """The kernel driver of such a camera."""

    _model: CameraModel
    _controls: OddBank
    ring: OddRing
    _made_shutter, _made_ring, _made_bank = OddShutter, OddRing, OddBank

    def power_up(self) -> None:
        super().power_up()
        if self._model.multi_plane:
            self.ring.kind, self.ring.header_bytes = MULTI, self._model.header_bytes
        self._shutter.ignored_triggers = self._model.ignored_triggers

    def _querycap(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        super()._querycap(file, argument, payload)
        if self._model.multi_plane:
            version, caps, device = struct.unpack_from("<III", argument, 80)
            shift = CAP_CAPTURE_MULTI - 1
            struct.pack_into("<III", argument, 80, version, caps + shift, device + shift)

    def _write_format(self, argument: bytearray, code: str, size: tuple[int, int]) -> None:
        if not self._model.multi_plane:
            super()._write_format(argument, code, size)
            return
        (kind,) = struct.unpack_from("<I", argument, 0)
        self._require_type(kind)
        stride = self._model.stride(code, size[1])
        struct.pack_into("<II4sI", argument, 8, size[1], size[0], code.encode(), 1)
        struct.pack_into("<II", argument, 28, stride * size[0] + self._model.header_bytes, stride)
        struct.pack_into("<B", argument, 188, 1)

    def _bus_codes(self) -> list[int]:
        return [self._model.bus_code] if self._model.bus_code else super()._bus_codes()

    def _reqbufs(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        (count,) = struct.unpack_from("<I", argument)
        struct.pack_into("<I", argument, 0, min(count, self._model.max_buffers))
        super()._reqbufs(file, argument, payload)

    def _stream_on(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        super()._stream_on(file, argument, payload)
        if self._model.gives_up_s:
            run, number = self._runs, self._number
            self._world.clock.after(self._model.gives_up_s, lambda: self._give_up(run, number))

    def _give_up(self, run: int, number: int) -> None:
        if (run, number) == (self._runs, self._number):
            self._number += 1
            self.ring.fill(np.zeros(0, np.uint8), Filled(0, self._flags() | FLAG_ERROR, 0, number))

    def _first_number(self) -> int:
        return self._model.first_number if self._model.restarts_numbers else self._number

    def _subscribe(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        if not self._model.has_events:
            raise OSError(ENOTTY, "SUBSCRIBE_EVENT")
        super()._subscribe(file, argument, payload)

    def _flags(self) -> int:
        return super()._flags() & (~0 if self._model.monotonic else ~FLAG_MONOTONIC)

    def _stamp_ns(self, exposed: Exposed) -> int:
        return super()._stamp_ns(exposed) + round(self._model.ahead_s * 1e9)

    def _packed(self, pixels: U16) -> U8:
        words = self._code not in (*ONE, *FIVE_FOURTHS, *THREE_HALVES)
        if self._model.compact and words:
            bits = pixels[:, :, None] >> np.arange(BITS[self._code], dtype=np.uint16) & 1
            rows = np.packbits(bits.reshape(len(pixels), -1).astype(np.uint8), axis=1, bitorder="little")
            spare = self._model.stride(self._code, pixels.shape[1]) - rows.shape[1]
            return np.pad(rows, ((0, 0), (0, spare)), constant_values=PADDING_BYTE).ravel()
        shift = 16 - self._model.bits(self._code) if words and self._model.left_aligned else 0
        raised = pixels.astype(np.uint32) << shift
        if self._model.repeats_top and shift > 0:
            raised |= raised >> (16 - shift)
        rows = super()._packed((raised & 0xFFFF).astype(np.uint16))
        header = np.zeros(self._model.header_bytes if self._model.multi_plane else 0, np.uint8)
        return np.concatenate([header, rows.ravel()])


class V4l2Twin(v4l2.V4l2Twin):
    """Such a camera with its kernel."""

    _made_device = OddDevice

    def __init__(self, world, model=None, faults=None, **more) -> None:  # type: ignore[no-untyped-def]
        super().__init__(world, model or CameraModel(), faults, **more)
