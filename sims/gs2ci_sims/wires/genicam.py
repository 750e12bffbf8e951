"""A GenICam camera with its GenTL producer: the twin below `CameraPort`.

Its features follow SFNC 2.7 (`genicam_nodes`), its pixels PFNC 2.4. Frame numbers count in 16 bits from 1, without 0,
as the blocks of GigE Vision 1. Time stamps are those of the camera's own clock, which has
another origin; they mark the start of exposure as SFNC's ChunkTimestamp ("generated when frame acquisition was
triggered", Basler ace user's manual), or a later event as with other makers. A frame without a free buffer is lost
together with its number. Lost packets leave the buffer incomplete (GenTL 1.6, BUFFER_INFO_IS_INCOMPLETE); harvesters
delivers neither such a buffer nor its number. After AcquisitionStart a camera needs some time until it accepts
triggers (AcquisitionStatus[FrameTriggerWait]); a trigger before that is lost.

Here: `GenicamModel` (a data sheet), `GenicamTwin`. Not here: when it exposes (`shutter`), cameras that differ from a
usual one (`tests/twins/genicam.py`).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from errno import EBUSY, ENODEV, ENOENT
from functools import partial
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import U8, U16, Rng
from gs2ci_drivers.ports import CameraBuffer, CameraIdentity, Feature, FeatureRefusalError, FeatureValue
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.genicam_nodes import Node, NodeTable, in_categories
from gs2ci_sims.wires.shutter import CameraShutter, Exposed, ShutterModel, Shutting
from gs2ci_sims.wires.v4l2_camera import STAMPING, CameraModel, Stamps
from gs2ci_sims.world import World

US: Final = 1e-6
LATCH_S = 2e-4
"""A command to the camera and its answer."""
SHORT_IDS = 65_535
FRAME: Final = "FrameStart"
TRIGGERS: Final = (FRAME, "AcquisitionStart", "FrameBurstStart", "ExposureStart")
FIXED_LIMIT_HZ = 1111.0
CALLS_KEPT = 10_000
SIZE_STEPS = {"Height": 2, "Width": 4}
BITS = {"8": 8, "10": 10, "12": 12, "14": 14, "16": 16}


@dataclass(frozen=True)
class GenicamModel(ShutterModel):
    """A camera's data sheet; further arguments as for `ShutterModel`.

    Args:
        height: Rows of the pixel array.
        width: Columns.
        formats: Pixel formats by their PFNC names; the first is the default.
        frame_trigger: The camera's name for the trigger of a frame, if another its only one: ExposureStart (IDS),
            FrameBurstStart (Hikrobot).
        trigger_input: The camera's name for the input that `trigger_line` is wired to.
        stamps: The event that a time stamp marks.
        clock_epoch_s: Time on its clock when the world's clock is at 0.
        clock_ppm: Rate error of its clock; positive runs fast.
        ready_s: From AcquisitionStart until it accepts triggers.
    """

    height: int = 64
    width: int = 96
    formats: tuple[str, ...] = ("Mono12", "Mono8", "Mono10", "Mono12p", "Mono10p", "Mono12Packed", "BayerRG12")
    frame_trigger: str = FRAME
    trigger_input: str = "Line1"
    stamps: Stamps = "start-of-exposure"
    clock_epoch_s: float = 4242.0
    clock_ppm: float = 40.0
    ready_s: float = 0.01


def bits_of(name: str) -> int:
    """Return the significant bits of a pixel format, by the number in its name."""
    digits = "".join(letter for letter in name if letter.isdigit())
    return BITS[digits]


def pack_pfnc(pixels: U16, name: str) -> U8:
    """Pack the pixels of each row, [H, W] uint16, to bytes, [H, bytes].

    PFNC 2.4: "p" is one stream of bits, the lowest bit of the first pixel first (written here bit by bit); "Packed"
    puts the high eight bits of two pixels around a byte with the low bits of both, those of the first in its low half.
    """
    rows = pixels.astype(np.uint32)
    bits = bits_of(name)
    if bits == 8:
        return rows.astype(np.uint8)
    if name.endswith("Packed"):
        if rows.shape[1] % 2:
            rows = np.pad(rows, ((0, 0), (0, 1)))
        first, second, low = rows[:, 0::2], rows[:, 1::2], bits - 8
        mask = (1 << low) - 1
        triples = [first >> low, (first & mask) | (second & mask) << 4, second >> low]
        return np.stack(triples, axis=2).astype(np.uint8).reshape(len(rows), -1)
    if name.endswith("p"):
        stream = (rows[:, :, None] >> np.arange(bits, dtype=np.uint32)) & 1
        return np.packbits(stream.reshape(len(rows), -1).astype(np.uint8), axis=1, bitorder="little")
    return np.stack([rows & 0xFF, rows >> 8], axis=2).astype(np.uint8).reshape(len(rows), -1)


class GenicamTwin:
    """A camera and its producer, as a `CameraPort`.

    Args:
        world: The simulated world, with clock, light and trigger bus.
        model: Its data sheet.
        faults: The faults to inject.
        rng: Draws jitter; the default is seeded with 0.
    """

    def __init__(
        self,
        world: World,
        model: GenicamModel | None = None,
        faults: FaultSet | None = None,
        *,
        rng: Rng | None = None,
    ) -> None:
        self.model = model or GenicamModel()
        self.faults = faults or FaultSet()
        self.streaming = False
        self.calls: deque[str] = deque(maxlen=CALLS_KEPT)
        """Names of the latest calls, for tests of their order."""
        self._world = world
        self._clock = world.clock
        self._plugged, self._opened = True, False
        self._buffers = 0
        self._full: deque[CameraBuffer] = deque()
        self._frames = 0
        self._began_s = 0.0
        self._latched_ns = 0
        self._clock_zero_s = self._clock.now_s() - self.model.clock_epoch_s
        self._never_ready = False
        self._power_up()
        self._shutter = self._made_shutter(
            world,
            self.model,
            self.faults,
            rng=rng or np.random.default_rng(0),
            exposure_s=self._exposure_s,
            deliver=self._deliver,
            active_low=self._active_low,
            delay_s=self._delay_s,
        )

    def _power_up(self) -> None:
        self.nodes = NodeTable(in_categories(self._make_nodes()), lambda: self.streaming)

    _made_shutter = CameraShutter

    @property
    def region(self) -> tuple[int, int, int, int]:
        """Get first row and column, rows and columns of the region that is read out."""
        top, left, height, width = (int(self.nodes.number(name)) for name in ("OffsetY", "OffsetX", "Height", "Width"))
        return top, left, height, width

    def unplug(self) -> None:
        """Unplug the camera."""
        self._halt()
        self._plugged = self._opened = False

    def plug_in(self) -> None:
        """Plug the camera in again, with its default settings."""
        if not self._plugged:
            self._plugged = True
            self._power_up()

    def list_cameras(self, producer: str) -> list[CameraIdentity]:
        """List the camera if it is plugged in."""
        del producer
        return [self._identity()] if self._plugged else []

    def open(self, producer: str, serial: str) -> CameraIdentity:
        """Open the camera, with any serial number.

        Raises:
            OSError: ENOENT if it is not plugged in; EBUSY if another program holds it.
        """
        del producer, serial
        self.calls.append("open")
        if self.faults.take("genicam.unplugged", "open"):
            self.unplug()
        if not self._plugged:
            raise OSError(ENOENT, "0 cameras")
        if self.faults.take("genicam.held", "open"):
            raise OSError(EBUSY, "the camera is held by another program")
        self._opened = True
        for fault, feature in (("genicam.gain_left", "Gain"), ("genicam.mirrored", "ReverseX")):
            left = self.faults.take(fault)
            if left is not None:
                self.nodes.write(feature, left.value if feature == "Gain" else True)
        return self._identity()

    def list_features(self) -> list[tuple[str, str]]:
        """List the features with their categories."""
        self._alive("list_features")
        return self.nodes.list()

    def describe(self, name: str) -> Feature | None:
        """Return a feature's present value and limits."""
        self._alive(f"describe {name}")
        return self.nodes.describe(name)

    def read(self, name: str) -> FeatureValue:
        """Read a feature."""
        self._alive(f"read {name}")
        return self.nodes.read(name)

    def write(self, name: str, value: FeatureValue) -> None:
        """Write a feature.

        Raises:
            TypeError: A float for an integer, as by EMVA's bindings (genicam 1.6.0, IInteger).
        """
        self._alive(f"write {name}")
        self._refuse(name)
        found = self.nodes.describe(name)
        if found is not None and found.kind == "integer" and isinstance(value, float):
            raise TypeError(f"{name} = {value!r} is no integer")
        self.nodes.write(name, value)
        if name.startswith("Binning"):
            self._fit_region()

    def _fit_region(self) -> None:
        """Make the region as small as the binned sensor is (docs.baslerweb.com/image-roi: in binned lines)."""
        for size, offset in (("Height", "OffsetY"), ("Width", "OffsetX")):
            most, step = int(self.nodes.number(f"{size}Max")), SIZE_STEPS[size]
            if self.nodes.number(size) + self.nodes.number(offset) > most:
                self.nodes.put(offset, 0)
                self.nodes.put(size, min(int(self.nodes.number(size)), most // step * step))

    def execute(self, name: str) -> None:
        """Run a command, which takes a while."""
        self._alive(name)
        self._clock.sleep_s(LATCH_S / 2)
        self.nodes.execute(name)
        self._clock.sleep_s(LATCH_S / 2)

    def start(self, buffers: int, chunks: tuple[str, ...]) -> int:
        """Begin the acquisition."""
        self._alive("AcquisitionStart")
        del chunks  # frames carry the chunks that ChunkEnable selects, whatever is requested here
        self._buffers, self.streaming, self._frames = buffers, True, 0
        self._refuse("AcquisitionStart")  # harvesters streams by now, and has locked the features
        self._began_s = self._clock.now_s()
        self._never_ready = self.faults.take("genicam.never_ready") is not None
        others = {*TRIGGERS} - {self.model.frame_trigger} if "TriggerSelector" in self.nodes else set()
        if any(self.nodes.of("TriggerMode", other) == "On" for other in others):
            return buffers  # the camera waits for another kind of trigger, which is never sent
        if self.nodes.of("TriggerMode", self.model.frame_trigger) == "Off":
            self._shutter.start(Shutting.FREE)
        elif self._wired():
            gated = self.nodes.read("ExposureMode") == "TriggerWidth"
            how = Shutting.LEVEL if gated else Shutting.EDGE
            self._clock.after(self.model.ready_s, lambda: self._shutter.start(how) if self.streaming else None)
        return buffers

    def fetch(self, timeout_s: float) -> CameraBuffer | None:
        """Wait for a full buffer and queue it again."""
        self._alive("fetch")
        self._refuse("fetch")
        self._clock.wait_until(lambda: bool(self._full) or not self._plugged, timeout_s)
        if not self._plugged:
            raise OSError(ENODEV, "the camera is gone")
        return self._full.popleft() if self._full else None

    def stop(self) -> None:
        """End the acquisition."""
        self.calls.append("stop")
        self._refuse("AcquisitionStop")
        self._halt()

    def clock_ns(self) -> int:
        """Get the time of the simulated computer."""
        return self._clock.now_ns()

    def close(self) -> None:
        """Close the camera."""
        self.calls.append("close")
        self._halt()
        self._opened = False

    def _halt(self) -> None:
        self._shutter.stop()
        self.streaming = False
        self._full.clear()

    def _alive(self, asked: str) -> None:
        self.calls.append(asked)
        if self.faults.take("genicam.unplugged", asked):
            self.unplug()
        if not self._plugged or not self._opened:
            raise OSError(ENODEV, "the camera is gone")

    def _refuse(self, asked: str) -> None:
        if self.faults.take("genicam.feature_refused", asked):
            raise FeatureRefusalError(f"{asked}: access denied")

    def _identity(self) -> CameraIdentity:
        return CameraIdentity("Twin", "Sfnc 2.7", "0001", "GEV")

    def _ready(self) -> bool:
        waited_s = self._clock.now_s() - self._began_s
        return self.streaming and not self._never_ready and waited_s >= self.model.ready_s

    def _latch(self) -> None:
        self._latched_ns = self._camera_ns(self._clock.now_s())

    def _camera_ns(self, when_s: float) -> int:
        return round((when_s - self._clock_zero_s) * (1 + self.model.clock_ppm * 1e-6) * 1e9)

    def _deliver(self, exposed: Exposed) -> None:
        """Integrate the light of an exposure and schedule the delivery of the frame."""
        _, _, height, width = self.region
        name = str(self.nodes.read("PixelFormat"))
        pixels = self._pixels(exposed, height, width, bits_of(name))
        number, self._frames = self._frames, self._frames + 1
        if self.faults.take("genicam.clock_reset"):
            self._clock_zero_s = self._clock.now_s()
        stamped_s = {
            "start-of-exposure": exposed.start_s,
            "start-of-frame": exposed.end_s,
            "end-of-frame": exposed.end_s + self.model.readout_s,
        }[self.model.stamps]
        if self.faults.take("genicam.frame_lost") or len(self._full) >= self._buffers:
            return
        buffer = self._sent(pixels, name, number, self._camera_ns(stamped_s), exposed)
        if self.faults.take("genicam.incomplete"):
            buffer = CameraBuffer(b"", False, -1, None)
        if self.faults.take("genicam.other_size"):
            buffer = replace(buffer, height=height - 2)
        self._full.append(buffer)

    def _sent(self, pixels: U16, name: str, number: int, stamp: int, exposed: Exposed) -> CameraBuffer:
        data, chunks = pack_pfnc(pixels.reshape(1, -1), name).tobytes(), self._chunks(stamp, exposed)
        height, width = pixels.shape
        return CameraBuffer(data, True, number % SHORT_IDS + 1, stamp, height, width, chunks=chunks)

    def _chunks(self, stamp: int, exposed: Exposed) -> dict[str, float]:
        told = {"Timestamp": stamp, "ExposureTime": (exposed.end_s - exposed.start_s) / US}
        active = self.nodes.read("ChunkModeActive")
        return {f"Chunk{entry}": one for entry, one in told.items() if active and self.nodes.of("ChunkEnable", entry)}

    def _active_low(self) -> bool:
        return self.nodes.of("TriggerActivation", self.model.frame_trigger) == "FallingEdge"

    def _wired(self) -> bool:
        """Return whether it is triggered by the line that is wired."""
        return self.nodes.of("TriggerSource", self.model.frame_trigger) == self.model.trigger_input

    _unit_s: float = US
    """Unit of its times."""

    def _delay_s(self) -> float:
        return self.nodes.of_number("TriggerDelay", self.model.frame_trigger) * self._unit_s

    def _exposure_s(self) -> float:
        return self.nodes.number("ExposureTime") * self._unit_s

    def _pixels(self, exposed: Exposed, height: int, width: int, bits: int) -> U16:
        """Return the camera's readings of its light with the settings that were left on it, [H, W]."""
        down, right = int(self.nodes.number("BinningVertical")), int(self.nodes.number("BinningHorizontal"))
        pixels = self._integrate(exposed, height * down, width * right, bits)
        top = (1 << bits) - 1
        binned = pixels.reshape(height, down, width, right).sum(axis=(1, 3), dtype=np.uint32)
        shares = np.minimum(binned, top) / top
        if self.nodes.read("TestPattern") != "Off":
            shares = np.broadcast_to(np.arange(width) % 256 / 255, (height, width))
        bent = np.rint(top * shares ** self.nodes.number("Gamma")).astype(np.uint16)
        if self.nodes.read("ReverseX"):
            bent = bent[:, ::-1]
        return self._processed(np.ascontiguousarray(bent), top)

    def _integrate(self, exposed: Exposed, height: int, width: int, bits: int) -> U16:
        return self._world.integrate(exposed.start_s, exposed.end_s, height=height, width=width, bits=bits)

    def _processed(self, pixels: U16, top: int) -> U16:
        gain = 10 ** (self.nodes.number("Gain") / 20)
        return np.minimum(np.rint(pixels * gain), top).astype(np.uint16)

    def _make_nodes(self) -> dict[str, Node]:
        model = self.model
        triggers = TRIGGERS if model.frame_trigger == FRAME else (model.frame_trigger,)
        inputs = tuple(dict.fromkeys(("Software", "Line0", "Line1", model.trigger_input)))
        return {
            **self._sizes(),
            "PixelFormat": Node("enumeration", model.formats[0], symbols=model.formats, locked=True),
            "AcquisitionMode": Node("enumeration", "Continuous", symbols=("Continuous", "SingleFrame")),
            "AcquisitionFrameRate": Node("float", 60.0, lambda: 1.0, lambda: FIXED_LIMIT_HZ, 1e-3),
            "AcquisitionStatusSelector": Node(
                "enumeration", "FrameTriggerWait", symbols=("FrameTriggerWait", "ExposureActive")
            ),
            "AcquisitionStatus": Node("boolean", False, fixed=True, read=self._ready),
            "TriggerSelector": Node("enumeration", triggers[0], symbols=triggers),
            "TriggerMode": Node("enumeration", "Off", symbols=("Off", "On"), selector="TriggerSelector"),
            "TriggerSource": Node("enumeration", "Software", symbols=inputs, selector="TriggerSelector"),
            "TriggerActivation": Node(
                "enumeration", "RisingEdge", symbols=("RisingEdge", "FallingEdge"), selector="TriggerSelector"
            ),
            "TriggerDelay": Node("float", 0.0, high=lambda: 1e6, step=0.1, selector="TriggerSelector", unit="us"),
            "ExposureMode": Node("enumeration", "Timed", symbols=("Timed", "TriggerWidth")),
            "ExposureAuto": Node("enumeration", "Continuous", symbols=("Off", "Continuous")),
            "ExposureTime": Node("float", 10_000.0, lambda: 20.0, lambda: 10e6, 0.5, unit="us"),
            "GainAuto": Node("enumeration", "Off", symbols=("Off", "Continuous")),
            "Gain": Node("float", 0.0, high=lambda: 24.0, step=0.1, unit="dB"),
            "DeviceTemperature": Node("float", 41.5, fixed=True),
            # Only a loss of power or UserSetLoad resets these: another program may have left them.
            "BinningHorizontal": Node("integer", 1, lambda: 1.0, lambda: 2.0, locked=True),
            "BinningVertical": Node("integer", 1, lambda: 1.0, lambda: 2.0, locked=True),
            "ReverseX": Node("boolean", False, locked=True),
            "Gamma": Node("float", 1.0, lambda: 0.25, lambda: 4.0, 0.01),
            "TestPattern": Node("enumeration", "Off", symbols=("Off", "GreyHorizontalRamp")),
            "SensorReadoutTime": Node("float", model.readout_s / US, fixed=True),
            "TimestampLatch": Node("command", run=self._latch),
            "TimestampLatchValue": Node("integer", fixed=True, read=lambda: self._latched_ns),
            "ChunkModeActive": Node("boolean", False),
            "ChunkSelector": Node("enumeration", "Image", symbols=("Image", "Timestamp", "ExposureTime")),
            "ChunkEnable": Node("boolean", False, selector="ChunkSelector"),
        }

    def _sizes(self) -> dict[str, Node]:
        """Return the nodes of size and offset, whose sum is limited to the pixel array."""
        found: dict[str, Node] = {}

        def left_by(name: str, largest: int) -> Callable[[], float]:
            return lambda: largest // binning(name) - float(found[name].value)

        def binning(name: str) -> int:
            down = name in ("Height", "OffsetY")
            return int(self.nodes.number("BinningVertical" if down else "BinningHorizontal"))

        for size, offset, largest in (
            ("Height", "OffsetY", self.model.height),
            ("Width", "OffsetX", self.model.width),
        ):
            step = SIZE_STEPS[size]
            least = float(2 * step)
            found[f"{size}Max"] = Node(
                "integer", fixed=True, read=partial(lambda largest, size: largest // binning(size), largest, size)
            )
            found[size] = Node("integer", largest, partial(float, least), left_by(offset, largest), step, locked=True)
            found[offset] = Node("integer", 0, high=left_by(size, largest), step=step, locked=True)
        return found


def simulated(world: World, settings: Any) -> GenicamTwin:
    """Build the twin that a rig file's [sensor] and [world] describe."""
    table, offered = world.stated.table, GenicamModel().formats
    rows, columns = table.camera_array or (table.height, table.width)
    first = (settings.format,) if settings.format else ()
    model = GenicamModel(
        height=rows,
        width=columns,
        formats=(*first, *(name for name in offered if name not in first)),
        trigger_line=world.stated.trigger_line,
        trigger_input=settings.trigger_line,
        stamps=STAMPING[table.camera_driver][0],
        latency_s=table.trigger_latency_s,
        jitter_s=table.trigger_jitter_s,
        exposure_offset_s=table.trigger_exposure_offset_s,
        readout_s=table.height * CameraModel.line_s if table.camera_readout_s is None else table.camera_readout_s,
    )
    return GenicamTwin(world, model, world.stated.faults["sensor"], rng=np.random.default_rng(table.seed))
