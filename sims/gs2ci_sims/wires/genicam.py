"""A GenICam camera with its GenTL producer: the twin below `CameraPort`.

Its features follow SFNC 2.7 (`genicam_nodes`), its pixels PFNC 2.4. Frame numbers count in 16 bits from 1, without 0,
as the blocks of GigE Vision 1, or from 0 as in USB3 Vision. Time stamps are those of the camera's own clock, which has
another origin; they mark the start of exposure as SFNC's ChunkTimestamp ("generated when frame acquisition was
triggered", Basler ace user's manual), or a later event as with other makers. A frame without a free buffer is lost
together with its number. Lost packets leave the buffer incomplete (GenTL 1.6, BUFFER_INFO_IS_INCOMPLETE); harvesters
delivers neither such a buffer nor its number. After AcquisitionStart a camera needs some time until it accepts
triggers (AcquisitionStatus[FrameTriggerWait]); a trigger before that is lost.

Here: `GenicamModel` (a data sheet), `GenicamTwin`. Not here: when it exposes (`shutter`).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from errno import EBUSY, ENODEV, ENOENT
from functools import partial
from typing import Any, Literal

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci_drivers.ports import CameraBuffer, CameraIdentity, Feature, FeatureRefusalError, FeatureValue
from gs2ci_sims.faults import FaultSet, declare
from gs2ci_sims.wires.genicam_nodes import Node, NodeTable
from gs2ci_sims.wires.genicam_processing import further_features, in_categories, process
from gs2ci_sims.wires.shutter import CameraShutter, Exposed, ShutterModel, Shutting, by_rows
from gs2ci_sims.wires.v4l2_camera import STAMPING, CameraModel, Stamps
from gs2ci_sims.world import World

UNPLUGGED = declare("genicam.unplugged", "the camera disappears (ENODEV) until plugged in again")
HELD = declare("genicam.held", "another program holds the camera (EBUSY)")
INCOMPLETE = declare("genicam.incomplete", "packets of a frame are lost: its buffer is incomplete")
LOST = declare("genicam.frame_lost", "a frame is lost in transfer, and its number with it")
OTHER_SIZE = declare("genicam.other_size", "a frame has fewer rows than were set")
REFUSED = declare("genicam.feature_refused", "the camera refuses a write to a feature, or a command of the acquisition")
GAIN_LEFT = declare("genicam.gain_left", "another program has left the gain at `value` dB")
MIRRORED = declare("genicam.mirrored", "another program has left the picture mirrored")
NEVER_READY = declare("genicam.never_ready", "the camera never reports that it waits for triggers")
CLOCK_RESET = declare("genicam.clock_reset", "the camera's time stamps begin again at 0")

US = 1e-6
TIME_UNITS_S = {"us": 1e-6, "ms": 1e-3, "ns": 1e-9, "px": 1e-6}
LATCH_S = 2e-4
"""A command to the camera and its answer."""
SHORT_IDS = 65_535
FIXED_LIMIT_HZ = 1111.0
CALLS_KEPT = 10_000
BITS = {"8": 8, "10": 10, "12": 12, "14": 14, "16": 16}


@dataclass(frozen=True)
class GenicamModel(ShutterModel):
    """A camera's data sheet; further arguments as for `ShutterModel`.

    Args:
        height: Rows of the pixel array.
        width: Columns.
        formats: Pixel formats by their PFNC names; the first is the default.
        padding_bytes: Padding after each row, in bytes.
        transport: Transport layer, which determines the frame numbers.
        trigger_input: The camera's name for the input that `trigger_line` is wired to.
        gated: Whether it has ExposureMode TriggerWidth.
        stamps: The event that a time stamp marks.
        stamped: Whether its clock can be latched.
        chunks: Whether it appends chunks.
        clock_epoch_s: Time on its clock when the world's clock is at 0.
        clock_ppm: Rate error of its clock; positive runs fast.
        ready_s: From AcquisitionStart until it accepts triggers.
        tells: How its readout time can be known: "time": from SensorReadoutTime; "rate": from the highest frame rate at
            the exposure set, ResultingFrameRate (Basler); "limit": from the limit of AcquisitionFrameRate, which
            follows the exposure; "nothing": that limit is a fixed number (mvBlueFOX3).
        least_delay_us: Least TriggerDelay: 9 on a Blackfly S (blackfly_s.yaml of flir_camera_driver, "value >= 9").
        locks_triggers: Whether what a trigger is cannot be set while TriggerMode is On (Spinnaker's example Trigger:
            "The trigger must be disabled in order to configure" its source).
        has_activation: Whether it has TriggerActivation, which SFNC recommends and does not require (Aravis issue 460).
        has_selector: Whether it has TriggerSelector (Aravis pull request 671: an Imperx has none).
        goes_on: Whether its frame numbers go on after a stop (Aravis issue 762: FLIR and Point Grey, GigE Vision).
        gain_unit: Unit of Gain: "dB", or "" for a factor without a unit (Chromasens).
        time_unit: Unit of ExposureTime and TriggerDelay: SFNC's is "us".
        auto_gain: Gain at which automatic gain stands while it is on; it stays there when it is switched off.
        processing: Whether it has further features that change readings (`genicam_processing`).
        debouncer_us: LineDebouncerTime at power-up, and its least value; None: it has none. A level counts once it has
            lasted for that long, so that edges act later by as much and shorter pulses are lost
            (docs.baslerweb.com/line-debouncer; Basler aviator's manual: 10 us by default).
        line_left: LineMode and LineInverter of each line, as another program has left them; None: it has no such
            features. An inverter turns edges round before anything else ("after any processing by the line inverter
            module", Teledyne Linea HS manual), and an output takes none.
        shutters: Entries of SensorShutterMode, that at power-up first; none: it has no such feature. Behind "Rolling"
            each quarter of the rows begins and ends later than the one above it, the last one by `readout_s`.
        link: DeviceLinkThroughputLimit in bytes a second and its mode, as another program has left them; None: it has
            no such features. "If a DeviceLinkThroughputLimit is set and the unlimited link speed exceeds the set limit,
            the acquisition frame rate would be adjusted" (Balluff CA-SF, Optimizing the bandwidth); triggers before
            that are lost, as before AcquisitionFrameRate allows them.
    """

    height: int = 64
    width: int = 96
    formats: tuple[str, ...] = ("Mono12", "Mono8", "Mono10", "Mono12p", "Mono10p", "Mono12Packed", "BayerRG12")
    padding_bytes: int = 0
    transport: Literal["GEV", "U3V"] = "GEV"
    trigger_input: str = "Line1"
    gated: bool = True
    stamps: Stamps = "start-of-exposure"
    stamped: bool = True
    chunks: bool = True
    clock_epoch_s: float = 4242.0
    clock_ppm: float = 40.0
    ready_s: float = 0.01
    tells: Literal["time", "rate", "limit", "nothing"] = "time"
    least_delay_us: float = 0.0
    locks_triggers: bool = False
    has_activation: bool = True
    has_selector: bool = True
    goes_on: bool = False
    gain_unit: str = "dB"
    time_unit: Literal["us", "ms", "ns", "px"] = "us"
    auto_gain: float = 0.0
    processing: bool = False
    debouncer_us: tuple[float, float] | None = None
    line_left: tuple[Literal["Input", "Output"], bool] | None = None
    shutters: tuple[str, ...] = ()
    link: tuple[int, Literal["On", "Off"]] | None = None


def bits_of(name: str) -> int:
    """Return the significant bits of a pixel format, by the number in its name."""
    digits = "".join(letter for letter in name if letter.isdigit())
    return BITS[digits]


def pack_pfnc(pixels: U16, name: str, padding_bytes: int = 0) -> bytes:
    """Pack pixels, [H, W] uint16, as a camera sends them; padding bytes are 0xA5.

    PFNC 2.4: "p" is one stream of bits, the lowest bit of the first pixel first (written here bit by bit); "Packed"
    puts the high eight bits of two pixels around a byte with the low bits of both, those of the first in its low half.
    """
    rows = pixels if padding_bytes else pixels.reshape(1, -1)
    packed = _pack_rows(rows.astype(np.uint32), name)
    return np.pad(packed, ((0, 0), (0, padding_bytes)), constant_values=0xA5).tobytes()


def _pack_rows(rows: np.ndarray[tuple[int, int], np.dtype[np.uint32]], name: str) -> U8:
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
        rng: np.random.Generator | None = None,
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
        self.nodes = NodeTable(self._make_nodes(), lambda: self.streaming)
        self._shutter = CameraShutter(
            world,
            self.model,
            self.faults,
            rng=rng or np.random.default_rng(0),
            exposure_s=self._exposure_s,
            deliver=self._deliver,
            active_low=lambda: (
                (self._trigger("TriggerActivation", "RisingEdge") == "FallingEdge")
                != bool(self._of_line("LineInverter", absent=False))
            ),
            delay_s=lambda: float(self._trigger("TriggerDelay", 0.0)) * self._unit_s,
            least_period_s=self._least_period_s,
            debounce_s=self._debounce_s,
        )

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
            self.nodes = NodeTable(self._make_nodes(), lambda: self.streaming)

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
        if self.faults.take(UNPLUGGED, "open"):
            self.unplug()
        if not self._plugged:
            raise OSError(ENOENT, "0 cameras")
        if self.faults.take(HELD, "open"):
            raise OSError(EBUSY, "the camera is held by another program")
        self._opened = True
        for fault, feature in ((GAIN_LEFT, "Gain"), (MIRRORED, "ReverseX")):
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
        """Write a feature."""
        self._alive(f"write {name}")
        self._refuse(name)
        automatic = name == "GainAuto" and self.nodes.read(name) != "Off"
        self.nodes.write(name, value)
        if automatic and value == "Off":
            self.nodes.write("Gain", self.model.auto_gain)

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
        self._buffers, self.streaming = buffers, True
        if not self.model.goes_on:
            self._frames = 0
        self._refuse("AcquisitionStart")  # harvesters streams by now, and has locked the features
        self._began_s = self._clock.now_s()
        self._never_ready = self.faults.take(NEVER_READY) is not None
        others = ("AcquisitionStart", "FrameBurstStart") if self.model.has_selector else ()
        if any(self.nodes.of("TriggerMode", other) == "On" for other in others):
            return buffers  # the camera waits for another kind of trigger, which is never sent
        if self._trigger("TriggerMode", "Off") == "Off":
            self._shutter.start(Shutting.FREE)
        elif (
            self._trigger("TriggerSource", "") == self.model.trigger_input
            and self._of_line("LineMode", absent="Input") == "Input"
        ):
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
        if self.faults.take(UNPLUGGED, asked):
            self.unplug()
        if not self._plugged or not self._opened:
            raise OSError(ENODEV, "the camera is gone")

    def _refuse(self, asked: str) -> None:
        if self.faults.take(REFUSED, asked):
            raise FeatureRefusalError(f"{asked}: access denied")

    def _identity(self) -> CameraIdentity:
        return CameraIdentity("Twin", "Sfnc 2.7", "0001", self.model.transport)

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
        if self.faults.take(CLOCK_RESET):
            self._clock_zero_s = self._clock.now_s()
        stamped_s = {
            "start-of-exposure": exposed.start_s,
            "start-of-frame": exposed.end_s,
            "end-of-frame": exposed.end_s + self.model.readout_s,
        }[self.model.stamps]
        if self.faults.take(LOST) or len(self._full) >= self._buffers:
            return
        stamp = self._camera_ns(stamped_s) if self.model.stamped else None
        data = pack_pfnc(pixels, name, self.model.padding_bytes)
        buffer = CameraBuffer(
            data,
            True,
            number % SHORT_IDS + 1 if self.model.transport == "GEV" else number,
            stamp,
            height,
            width,
            self.model.padding_bytes,
            self._chunks(stamp, exposed),
        )
        if self.faults.take(INCOMPLETE):
            buffer = CameraBuffer(b"", False, -1, None)
        if self.faults.take(OTHER_SIZE):
            buffer = replace(buffer, height=height - 2)
        self._full.append(buffer)

    def _trigger(self, name: str, absent: FeatureValue) -> FeatureValue:
        """Return a property of the trigger FrameStart, or what holds where the camera has no such feature."""
        return self.nodes.of(name, "FrameStart") if name in self.nodes else absent

    def _of_line(self, name: str, *, absent: FeatureValue) -> FeatureValue:
        """Return a property of the trigger's line, or what holds where the camera has no such feature."""
        return self.nodes.of(name, self.model.trigger_input) if self.model.line_left else absent

    @property
    def _unit_s(self) -> float:
        return TIME_UNITS_S[self.model.time_unit]

    def _exposure_s(self) -> float:
        return self.nodes.number("ExposureTime") * self._unit_s

    def _delay_node(self) -> tuple[float, Callable[[], float], Callable[[], float], float]:
        """Return value, limits and step of TriggerDelay: up to 1 s in steps of 0.1 us, in the camera's unit."""
        per_us = US / self._unit_s
        least = self.model.least_delay_us * per_us
        return least, lambda: least, lambda: 1e6 * per_us, 0.1 * per_us

    def _exposure_node(self) -> tuple[float, Callable[[], float], Callable[[], float], float]:
        """Return value, limits and step of ExposureTime: 20 us to 10 s in steps of 0.5 us, in the camera's unit."""
        per_us = US / self._unit_s
        return 10_000.0 * per_us, lambda: 20.0 * per_us, lambda: 10e6 * per_us, 0.5 * per_us

    def _debounce_s(self) -> float:
        return (
            float(self.nodes.of("LineDebouncerTime", self.model.trigger_input)) * US if self.model.debouncer_us else 0.0
        )

    def _least_period_s(self) -> float:
        limited = "AcquisitionFrameRateEnable" in self.nodes and self.nodes.read("AcquisitionFrameRateEnable")
        rate_s = 1 / self.nodes.number("AcquisitionFrameRate") if limited else 0.0
        if not self.model.link or self.nodes.read("DeviceLinkThroughputLimitMode") == "Off":
            return rate_s
        return max(rate_s, self._payload_bytes() / self.nodes.number("DeviceLinkThroughputLimit"))

    def _payload_bytes(self) -> int:
        _, _, height, width = self.region
        name = str(self.nodes.read("PixelFormat"))
        return len(pack_pfnc(np.zeros((height, width), np.uint16), name, self.model.padding_bytes))

    def _pixels(self, exposed: Exposed, height: int, width: int, bits: int) -> U16:
        """Return the camera's readings of its light with the settings that were left on it, [H, W]."""
        down, right = int(self.nodes.number("BinningVertical")), int(self.nodes.number("BinningHorizontal"))
        size = {"height": height * down, "width": width * right}
        rolls = self.model.shutters and self.nodes.read("SensorShutterMode") == "Rolling"
        skew_s, integrate = self.model.readout_s if rolls else 0.0, partial(self._world.integrate, **size, bits=bits)
        pixels = by_rows(exposed, skew_s, size["height"], integrate)
        top = (1 << bits) - 1
        binned = pixels.reshape(height, down, width, right).sum(axis=(1, 3), dtype=np.uint32)
        shares = np.minimum(binned, top) / top
        if self.nodes.read("TestPattern") != "Off":
            shares = np.broadcast_to(np.arange(width) % 256 / 255, (height, width))
        bent = np.rint(top * shares ** self.nodes.number("Gamma")).astype(np.uint16)
        if self.nodes.read("ReverseX"):
            bent = bent[:, ::-1]
        return process(np.ascontiguousarray(bent), top, self.nodes, factor=self.model.gain_unit != "dB")

    def _chunks(self, stamp: int | None, exposed: Exposed) -> dict[str, float]:
        if not self.model.chunks or not self.nodes.read("ChunkModeActive"):
            return {}
        told: dict[str, float | None] = {
            "Timestamp": stamp,
            "ExposureTime": (exposed.end_s - exposed.start_s) / US,
        }
        return {
            f"Chunk{entry}": value
            for entry, value in told.items()
            if value is not None and self.nodes.of("ChunkEnable", entry)
        }

    def _highest_rate_hz(self) -> float:
        return 1 / max(self.model.own_period_s, self._exposure_s() + self.model.readout_s)

    def _rate_limit_hz(self) -> float:
        return self._highest_rate_hz() if self.model.tells == "limit" else FIXED_LIMIT_HZ

    def _make_nodes(self) -> dict[str, Node]:
        model = self.model
        triggers = ("FrameStart", "AcquisitionStart", "FrameBurstStart")
        inputs = tuple(dict.fromkeys(("Software", "Line0", "Line1", model.trigger_input)))
        least_gain = 0.0 if model.gain_unit == "dB" else 1.0
        nodes = {
            **self._sizes(),
            "PixelFormat": Node("enumeration", model.formats[0], symbols=model.formats, locked=True),
            "AcquisitionMode": Node("enumeration", "Continuous", symbols=("Continuous", "SingleFrame")),
            "AcquisitionFrameRate": Node("float", 60.0, lambda: 1.0, self._rate_limit_hz, 1e-3),
            "AcquisitionStatusSelector": Node(
                "enumeration", "FrameTriggerWait", symbols=("FrameTriggerWait", "ExposureActive")
            ),
            "AcquisitionStatus": Node("boolean", False, fixed=True, read=self._ready),
            "TriggerSelector": Node("enumeration", "FrameStart", symbols=triggers),
            "TriggerMode": Node("enumeration", "Off", symbols=("Off", "On"), selector="TriggerSelector"),
            "TriggerSource": Node("enumeration", "Software", symbols=inputs, selector="TriggerSelector"),
            "TriggerActivation": Node(
                "enumeration", "RisingEdge", symbols=("RisingEdge", "FallingEdge"), selector="TriggerSelector"
            ),
            "TriggerDelay": Node("float", *self._delay_node(), selector="TriggerSelector", unit=model.time_unit),
            "ExposureMode": Node(
                "enumeration", "Timed", symbols=("Timed", "TriggerWidth") if model.gated else ("Timed",)
            ),
            "ExposureAuto": Node("enumeration", "Continuous", symbols=("Off", "Continuous")),
            "ExposureTime": Node("float", *self._exposure_node(), unit=model.time_unit),
            "GainAuto": Node("enumeration", "Off", symbols=("Off", "Continuous")),
            "Gain": Node("float", least_gain, lambda: least_gain, lambda: 24.0, 0.1, unit=model.gain_unit),
            "DeviceTemperature": Node("float", 41.5, fixed=True),
            # Only a loss of power or UserSetLoad resets these: another program may have left them.
            "BinningHorizontal": Node("integer", 1, lambda: 1.0, lambda: 2.0, locked=True),
            "BinningVertical": Node("integer", 1, lambda: 1.0, lambda: 2.0, locked=True),
            "ReverseX": Node("boolean", False, locked=True),
            "Gamma": Node("float", 1.0, lambda: 0.25, lambda: 4.0, 0.01),
            "TestPattern": Node("enumeration", "Off", symbols=("Off", "GreyHorizontalRamp")),
        }
        self._vary(nodes)
        if model.debouncer_us is not None or model.line_left is not None:
            nodes["LineSelector"] = Node("enumeration", inputs[1], symbols=inputs[1:], category="DigitalIOControl")
        if model.line_left is not None:
            way, inverted = model.line_left
            nodes["LineMode"] = Node("enumeration", way, symbols=("Input", "Output"), selector="LineSelector")
            nodes["LineInverter"] = Node("boolean", inverted, selector="LineSelector")
        if model.debouncer_us is not None:
            found_us, least_us = model.debouncer_us
            nodes["LineDebouncerTime"] = Node(
                *("float", found_us, lambda: least_us, lambda: 20e3, 0.1), selector="LineSelector", unit="us"
            )
        if model.link is not None:
            nodes["PayloadSize"] = Node("integer", fixed=True, read=self._payload_bytes)
            nodes["DeviceLinkThroughputLimit"] = Node(
                "integer", model.link[0], lambda: 1000.0, lambda: 400e6, locked=True, unit="Bps"
            )
            nodes["DeviceLinkThroughputLimitMode"] = Node("enumeration", model.link[1], symbols=("On", "Off"))
        if model.shutters:
            nodes["SensorShutterMode"] = Node("enumeration", model.shutters[0], symbols=model.shutters, locked=True)
        if model.tells == "time":
            nodes["SensorReadoutTime"] = Node("float", model.readout_s / US, fixed=True)
        if model.tells == "rate":
            nodes["ResultingFrameRate"] = Node("float", fixed=True, read=self._highest_rate_hz)
        if model.stamped:
            nodes["TimestampLatch"] = Node("command", run=self._latch)
            nodes["TimestampLatchValue"] = Node("integer", fixed=True, read=lambda: self._latched_ns)
        if model.chunks:
            nodes["ChunkModeActive"] = Node("boolean", False)
            nodes["ChunkSelector"] = Node("enumeration", "Image", symbols=("Image", "Timestamp", "ExposureTime"))
            nodes["ChunkEnable"] = Node("boolean", False, selector="ChunkSelector")
        return in_categories(nodes | (further_features() if model.processing else {}))

    def _vary(self, nodes: dict[str, Node]) -> None:
        """Leave out what the camera has not, and lock what is locked while its trigger is on."""
        if not self.model.has_activation:
            del nodes["TriggerActivation"]
        for name, node in nodes.items():
            if self.model.locks_triggers and name in ("TriggerSource", "TriggerActivation", "TriggerDelay"):
                node.barred = lambda: self.nodes.read("TriggerMode") == "On"
            if not self.model.has_selector:
                node.selector = "" if node.selector == "TriggerSelector" else node.selector
        if not self.model.has_selector:
            del nodes["TriggerSelector"]

    def _sizes(self) -> dict[str, Node]:
        """Return the nodes of size and offset, whose sum is limited to the pixel array."""
        found: dict[str, Node] = {}

        def left_by(name: str, largest: int) -> Callable[[], float]:
            return lambda: largest // binning(name) - float(found[name].value)

        def binning(name: str) -> int:
            down = name in ("Height", "OffsetY")
            return int(self.nodes.number("BinningVertical" if down else "BinningHorizontal"))

        for size, offset, largest, step in (
            ("Height", "OffsetY", self.model.height, 2),
            ("Width", "OffsetX", self.model.width, 4),
        ):
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
