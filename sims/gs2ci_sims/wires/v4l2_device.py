"""The kernel driver of the V4L2 twin's camera: the effect of each request, and the transfer of a frame into a buffer.

Requests and answers are bytes at the offsets of linux/videodev2.h, which are written out here a second time: this
module shares nothing with the driver package, so that an error in a layout cannot cancel itself.

Here: `CaptureDevice`. Not here: descriptors, files and poll (`v4l2`), exposures (`v4l2_camera`), controls
(`v4l2_controls`), buffers (`v4l2_queue`).
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from errno import EBUSY, EINVAL, ENOENT, EPIPE
from functools import partial

import numpy as np

from gs2ci.core.arrays import U8, U16, Rng
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.shutter import CameraShutter, Exposed, Shutting, by_rows
from gs2ci_sims.wires.v4l2_camera import BITS, FIVE_FOURTHS, ONE, REALTIME_S, THREE_HALVES, CameraModel, pack_frame
from gs2ci_sims.wires.v4l2_controls import CID_TRIGGER_MODE, ControlBank
from gs2ci_sims.wires.v4l2_queue import FLAG_ERROR, FLAG_LAST, FLAG_MONOTONIC, FLAG_START_STAMP, BufferRing, Filled
from gs2ci_sims.world import World

CAP_CAPTURE, CAP_STREAMING, CAP_DEVICE = 0x1, 0x04000000, 0x80000000
MAX_BUFFERS = 32
POWER_DOWN_S = 1.0
"""Time after a stop for which a sensor stays powered; the module's parameter is read at power-up."""
KERNEL_VERSION = 6 << 16 | 1 << 8
EVENT_END, EVENT_SOURCE = 2, 5
BUS_CODES = {
    0x2001: ("GREY",),
    0x200A: ("Y10 ", "Y10P"),
    0x2013: ("Y12 ", "Y12P"),
    0x202E: ("Y16 ",),
    0x3014: ("RGGB",),
    0x300F: ("RG10", "pRAA"),
    0x3012: ("RG12", "pRCC"),
    0x3020: ("RG16",),
}

SMALLEST = (4, 80)
"""Rows and columns of the smallest region (IMX296_FID0_ROIWV1_MIN, IMX296_FID0_ROIWH1_MIN)."""


def _up_to_fours(pixels: int) -> int:
    return -(-pixels // 4) * 4


Handler = Callable[["OpenFile", bytearray, bytearray | None], None]


@dataclass(eq=False)
class OpenFile:
    """An open descriptor of a node, as the kernel keeps it.

    Args:
        generation: Number of times that the camera had been unplugged before it was opened.
        subdevice: Whether it is the sensor's own node.
    """

    generation: int
    subdevice: bool
    subscribed: set[int] = field(default_factory=set)
    events: list[int] = field(default_factory=list)


class CaptureDevice:
    """A camera in the simulated world, with its kernel driver.

    Args:
        world: The simulated world, with clock, light and trigger bus.
        model: Its data sheet.
        faults: The faults to inject.
        rng: Draws jitter.
    """

    _made_shutter, _made_ring, _made_bank = CameraShutter, BufferRing, ControlBank

    def __init__(self, world: World, model: CameraModel, faults: FaultSet, rng: Rng) -> None:
        self.parameter = b"0"
        """The module's parameter `trigger_mode`; unplugging does not reset it."""
        self._world = world
        self._model = model
        self._faults = faults
        self._latched = b"0"
        self._powered_until_s = float("-inf")
        self._number = 0
        self._runs = 0
        self._files: list[OpenFile] = []
        self._shutter = self._made_shutter(
            world,
            model,
            faults,
            rng=rng,
            exposure_s=self._exposure_s,
            deliver=self._on_frame,
            active_low=lambda: model.active_low,
            longer_ppm=model.clock_ppm,
        )
        self.power_up()
        self.requests = self._table()
        self.sensor_requests: dict[int, tuple[str, Handler]] = {0xC0585605: ("SUBDEV_S_FMT", self._subdev_s_fmt)}
        if model.crops and model.on_subdevice:
            self.sensor_requests |= {
                0xC040563D: ("SUBDEV_G_SELECTION", lambda file, a, p: self._g_selection(a, target_at=8, rect_at=16)),
                0xC040563E: ("SUBDEV_S_SELECTION", lambda file, a, p: self._s_selection(a, target_at=8, rect_at=16)),
            }
        elif model.crops:
            self.requests |= {
                0xC040565E: ("G_SELECTION", lambda file, a, p: self._g_selection(a, target_at=4, rect_at=12)),
                0xC040565F: ("S_SELECTION", lambda file, a, p: self._s_selection(a, target_at=4, rect_at=12)),
            }
        if model.on_subdevice:
            for number in (0xC0E85667, 0xC02C5625, 0xC0205647, 0xC0205648):
                self.sensor_requests[number] = self.requests.pop(number)

    def power_up(self) -> None:
        """Set the state of a camera that has just been plugged in."""
        model = self._model
        self.ring = self._made_ring()
        self._owner: OpenFile | None = None
        self._code = model.formats[0]
        self._size = self._bus_size = (model.height, model.width)
        self.region = (0, 0, model.height, model.width)
        """First row and column, rows and columns that are read out."""
        self._controls = self._made_bank(model, self._faults, lambda: self.ring.streaming)

    def power_down(self) -> None:
        """Stop at once, as when the camera is unplugged."""
        self._runs += 1
        self._shutter.stop()
        self.ring.free()
        self._owner = None

    def opened(self, file: OpenFile) -> None:
        """Register a new descriptor."""
        self._files.append(file)

    def closed(self, file: OpenFile) -> None:
        """Remove a closed descriptor; if it owns the buffers, stop streaming and free them."""
        if file in self._files:
            self._files.remove(file)
        if file is self._owner:
            self._halt()
            self.ring.free()
            self._owner = None

    def leave(self, name: str, value: int) -> None:
        """Set a control as another program does."""
        self._controls.leave(name, value)

    def _exposure_s(self) -> float:
        short = self._faults.take("v4l2.exposed_short")
        return self._controls.exposure_s() * (1.0 if short is None else 0.1)

    def _table(self) -> dict[int, tuple[str, Handler]]:
        """Return name and handler of every request, by the numbers of linux/videodev2.h."""
        return {
            0x80685600: ("QUERYCAP", self._querycap),
            0xC0405602: ("ENUM_FMT", self._enum_fmt),
            0xC0D05604: ("G_FMT", lambda file, a, p: self._write_format(a, self._code, self._size)),
            0xC0D05605: ("S_FMT", self._s_fmt),
            0xC0D05640: ("TRY_FMT", lambda file, a, p: self._write_format(a, *self._fitted(a))),
            0xC0145608: ("REQBUFS", self._reqbufs),
            0xC0585609: ("QUERYBUF", lambda file, a, p: self.ring.describe(a, p)),
            0xC058560F: ("QBUF", self._qbuf),
            0xC0585611: ("DQBUF", self._dqbuf),
            0x40045612: ("STREAMON", self._stream_on),
            0x40045613: ("STREAMOFF", self._stream_off),
            0xC0E85667: ("QUERY_EXT_CTRL", lambda file, a, p: self._controls.query(a)),
            0xC02C5625: ("QUERYMENU", lambda file, a, p: self._controls.query_menu(a)),
            0xC0205647: ("G_EXT_CTRLS", lambda file, a, p: self._controls.batch(a, p, write=False)),
            0xC0205648: ("S_EXT_CTRLS", lambda file, a, p: self._controls.batch(a, p, write=True)),
            0x4020565A: ("SUBSCRIBE_EVENT", self._subscribe),
            0x80885659: ("DQEVENT", self._dqevent),
        }

    # ---- identity and formats

    def _querycap(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        caps = CAP_STREAMING | CAP_CAPTURE
        struct.pack_into("<16s32s32s", argument, 0, self._model.driver.encode(), b"Twin camera", b"platform:twin")
        struct.pack_into("<III", argument, 80, KERNEL_VERSION, caps | CAP_DEVICE, caps)

    def _require_type(self, kind: int) -> None:
        if kind != self.ring.kind:
            raise OSError(EINVAL, "buffer type")

    def _enum_fmt(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        index, kind = struct.unpack_from("<II", argument, 0)
        self._require_type(kind)
        if index >= len(self._model.formats):
            raise OSError(EINVAL, "ENUM_FMT")
        code = self._model.formats[index].encode()
        struct.pack_into("<I32s4s", argument, 8, 0, b"raw " + code, code)

    def _fitted(self, argument: bytearray) -> tuple[str, tuple[int, int]]:
        """Return the format and size that are nearest to the requested ones."""
        kind, _, width, height, raw = struct.unpack_from("<IIII4s", argument, 0)
        self._require_type(kind)
        code = raw.decode("latin-1")
        if code not in self._model.formats:
            code = self._model.formats[0]
        if self._model.on_subdevice:  # rp1-cfe: any size from 16 x 16 on (cfe_enum_framesizes)
            return code, (max(height, 16), max(width - width % 2, 16))
        return code, self._nearest(height, width)

    def _g_selection(self, argument: bytearray, *, target_at: int, rect_at: int) -> None:
        (target,) = struct.unpack_from("<I", argument, target_at)
        if target not in (0, 1, 2, 3):  # crop, its default and bounds, native size
            raise OSError(EINVAL, "selection target")
        top, left, height, width = self.region if target == 0 else (0, 0, self._model.height, self._model.width)
        struct.pack_into("<iiII", argument, rect_at, left, top, width, height)

    def _s_selection(self, argument: bytearray, *, target_at: int, rect_at: int) -> None:
        if self.ring.count:
            raise OSError(EBUSY, "S_SELECTION")
        if struct.unpack_from("<I", argument, target_at) != (0,):
            raise OSError(EINVAL, "selection target")
        left, top, width, height = struct.unpack_from("<iiII", argument, rect_at)
        rows, columns = self._model.height, self._model.width
        left, top = (
            min(max(_up_to_fours(at), 0), most)
            for at, most in ((left, columns - SMALLEST[1]), (top, rows - SMALLEST[0]))
        )
        width = min(max(_up_to_fours(width), SMALLEST[1]), columns, columns - left)
        height = min(max(_up_to_fours(height), SMALLEST[0]), rows, rows - top)
        self.region = (top, left, height, width)
        self._bus_size = (height, width)
        if not self._model.on_subdevice:
            self._size = (height, width)
        struct.pack_into("<iiII", argument, rect_at, left, top, width, height)

    def _nearest(self, height: int, width: int) -> tuple[int, int]:
        if self._model.crops and not self._model.on_subdevice:
            return self.region[2:]
        return (
            min(max(4, height - height % 2), self._model.height),
            min(max(4, width - width % 4), self._model.width),
        )

    def _s_fmt(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        if self.ring.count or self.ring.streaming:
            raise OSError(EBUSY, "S_FMT")
        code, (height, width) = self._fitted(argument)
        if self._faults.take("v4l2.size_changed"):
            height = max(4, height // 4 * 2)
        if self._faults.take("v4l2.format_changed"):
            code = next(other for other in self._model.formats if other != code)
        self._code, self._size = code, (height, width)
        if not self._model.on_subdevice:
            self._controls.frame_size(height, width)
        self._write_format(argument, code, self._size)

    def _write_format(self, argument: bytearray, code: str, size: tuple[int, int]) -> None:
        (kind,) = struct.unpack_from("<I", argument, 0)
        self._require_type(kind)
        height, width = size
        stride = self._model.stride(code, width)
        struct.pack_into("<II4sI", argument, 8, width, height, code.encode(), 1)
        struct.pack_into("<II", argument, 24, stride, stride * height)

    def _subdev_s_fmt(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        which, pad, width, height, bus = struct.unpack_from("<IIIII", argument, 0)
        if pad != 0:
            raise OSError(EINVAL, "pad")
        offered = self._bus_codes()
        size = self._nearest(height, width)
        if which:  # active, and not tried only, in a state of the file's own with the whole array
            size = self._bus_size = self.region[2:] if self._model.crops else size
            self._controls.frame_size(*size)
        bus = bus if bus in offered else offered[0]
        struct.pack_into("<III", argument, 8, size[1], size[0], bus)

    def _bus_codes(self) -> list[int]:
        """Return the sensor's bus formats, its default first."""
        return [code for code, names in BUS_CODES.items() if set(names) & set(self._model.formats)]

    # ---- buffers and streaming

    def _own(self, file: OpenFile) -> None:
        if self._owner is not None and self._owner is not file:
            raise OSError(EBUSY, "another descriptor owns the queue")

    def _reqbufs(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        self._own(file)
        fewer = self._faults.take("v4l2.buffers_fewer")
        most = MAX_BUFFERS if fewer is None else int(fewer.value)
        self.ring.request(argument, self._model.stride(self._code, self._size[1]) * self._size[0], most)
        self._owner = file if self.ring.count else None

    def _qbuf(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        self._own(file)
        self.ring.queue(argument, payload)

    def _dqbuf(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        self._own(file)
        self.ring.dequeue(argument, payload)

    def _stream_on(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        self._own(file)
        self._require_type(int.from_bytes(argument, "little"))
        if self._model.on_subdevice and self._bus_size != self._size:
            raise OSError(EPIPE, "the formats along the pipeline differ")
        self.ring.start()
        first = self._faults.take("v4l2.first_number")
        self._number = self._first_number() if first is None else int(first.value)
        self._shutter.start(self._rule())

    def _first_number(self) -> int:
        return 0

    def _rule(self) -> Shutting:
        """Return the event that begins an exposure; the module's parameter is read when the sensor powers up."""
        if self._model.trigger == "module":
            if self._world.clock.now_s() >= self._powered_until_s:
                self._latched = self.parameter
            return self._model.module_mode(int(self._latched))
        if self._model.trigger == "outside":
            return self._model.outside
        if self._model.trigger == "control":
            return {1: Shutting.EDGE, 2: Shutting.LEVEL}.get(self._controls[CID_TRIGGER_MODE], Shutting.FREE)
        return Shutting.FREE

    def _stream_off(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        self._own(file)
        self._require_type(int.from_bytes(argument, "little"))
        self._halt()

    def _halt(self) -> None:
        if self.ring.streaming:
            self._powered_until_s = self._world.clock.now_s() + POWER_DOWN_S
        self._runs += 1
        self._shutter.stop()
        self.ring.stop()

    # ---- events

    def _subscribe(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        (kind,) = struct.unpack_from("<I", argument, 0)
        if kind not in (EVENT_END, EVENT_SOURCE):
            raise OSError(EINVAL, "SUBSCRIBE_EVENT")
        file.subscribed.add(kind)

    def _dqevent(self, file: OpenFile, argument: bytearray, payload: bytearray | None) -> None:
        if not file.events:
            raise OSError(ENOENT, "DQEVENT")
        kind = file.events.pop(0)
        struct.pack_into("<II", argument, 0, kind, 0)
        struct.pack_into("<II", argument, 72, len(file.events), 0)

    # ---- frames

    def _on_frame(self, exposed: Exposed) -> None:
        """Process a frame that has been read out; it is counted even if it does not reach a buffer."""
        number, self._number = self._number, (self._number + 1) % (1 << 32)
        if self._faults.take("v4l2.source_changed"):
            for file in self._files:
                if EVENT_SOURCE in file.subscribed:
                    file.events.append(EVENT_SOURCE)
            return
        if self._faults.take("v4l2.stream_broken"):
            self.ring.broken = True
            return
        if self._faults.take("v4l2.frame_dropped"):
            return
        late = self._faults.take("v4l2.frame_late")
        if late is None:
            self._hand_over(exposed, number, self._runs)
        else:
            run = self._runs
            self._world.clock.after(late.value, lambda: self._hand_over(exposed, number, run))

    def _hand_over(self, exposed: Exposed, number: int, run: int) -> None:
        if run != self._runs or not self.ring.queued:
            return  # without a buffer the light of the frame need not be computed
        data = self._picture(exposed)
        filled = Filled(data.size, self._flags(), self._stamp_ns(exposed), number)
        if self._faults.take("v4l2.frame_corrupt"):
            filled.flags |= FLAG_ERROR
        if self._faults.take("v4l2.frame_short"):
            filled.bytes_used = data.size // 2
        if self._faults.take("v4l2.stream_ended"):
            filled.flags, filled.bytes_used, self.ring.ended = filled.flags | FLAG_LAST, 0, True
        if self._faults.take("v4l2.frame_repeated"):
            self._number = number
        self.ring.fill(data, filled)

    def _flags(self) -> int:
        return FLAG_MONOTONIC | (FLAG_START_STAMP if self._model.flags_start else 0)

    def _stamp_ns(self, exposed: Exposed) -> int:
        stale = self._faults.take("v4l2.frame_stale")
        times_s = {"start-of-exposure": exposed.start_s, "start-of-frame": exposed.end_s}
        when_s = times_s.get(self._model.stamps, self._world.clock.now_s())
        if self._faults.take("v4l2.frame_realtime"):
            when_s += REALTIME_S
        return round((when_s - (stale.value if stale else 0.0)) * 1e9)

    def _picture(self, exposed: Exposed) -> U8:
        height, width = self._size
        bits = self._model.bits(self._code)
        integrate = partial(self._world.integrate, height=height, width=width, bits=bits)
        pixels = by_rows(exposed, height * self._model.line_s if self._model.rolls else 0.0, height, integrate)
        pixels = self._controls.process(pixels, (1 << bits) - 1)
        words = self._code not in (*ONE, *FIVE_FOURTHS, *THREE_HALVES)
        if self._faults.take("v4l2.frame_noisy") and words and BITS[self._code] < 16:
            pixels = pixels | np.uint16(1 << 15)
        return self._packed(pixels)

    def _packed(self, pixels: U16) -> U8:
        return pack_frame(pixels, self._code, self._model.stride(self._code, pixels.shape[1]))
