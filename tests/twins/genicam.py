"""GenICam cameras unlike the usual one of the simulated bench: in units, locks, lines, limits, chunks, shutters.

Their features and what these do follow SFNC 2.7 and the makers that are named. Here: `GenicamModel`, `GenicamTwin` as
those of `gs2ci_sims.wires.genicam`, with what a rig file cannot state. Not here: processing (`genicam_processing`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from gs2ci.core.arrays import U16
from gs2ci_drivers.ports import CameraBuffer, CameraIdentity, Feature, FeatureRefusalError, FeatureValue
from gs2ci_sims.wires import genicam
from gs2ci_sims.wires.genicam import US, Node, NodeTable, in_categories
from gs2ci_sims.wires.shutter import Exposed, by_rows
from tests.twins.genicam_processing import further_features, process
from tests.twins.shutter import OddShutter

TIME_UNITS_S = {"us": 1e-6, "ms": 1e-3, "ns": 1e-9, "px": 1e-6}


@dataclass(frozen=True)
class GenicamModel(genicam.GenicamModel):
    """A camera's data sheet; further arguments as for the usual one.

    Args:
        padding_bytes: Padding after each row, in bytes.
        transport: Transport layer, which determines the frame numbers: those of USB3 Vision begin at 0.
        gated: Whether it has ExposureMode TriggerWidth.
        stamped: Whether its clock can be latched.
        chunks: Whether it appends chunks.
        tells: How its readout time can be known: "time": from SensorReadoutTime; "rate": from the highest frame rate at
            the exposure set, ResultingFrameRate (Basler), "allied": AcquisitionFrameRateLimit (Allied Vision); "limit":
            from the limit of AcquisitionFrameRate, which follows the exposure; "nothing": that is a fixed number
            (mvBlueFOX3), "balluff": from mvResultingFrameRate, AcquisitionFrameRate being not available
            (mvBlueFOX3-2032G, firmware 2.25, as arv-tool lists its features).
        least_delay_us: Least TriggerDelay: 9 on a Blackfly S (blackfly_s.yaml of flir_camera_driver, "value >= 9").
        locks_triggers: Whether what a trigger is cannot be set while TriggerMode is On (Spinnaker's example Trigger:
            "The trigger must be disabled in order to configure" its source).
        has_activation: Whether it has TriggerActivation, which SFNC recommends and does not require (Aravis issue 460).
        has_selector: Whether it has TriggerSelector (Aravis pull request 671: an Imperx has none).
        goes_on: Whether its frame numbers go on after a stop (Aravis issue 762: FLIR and Point Grey, GigE Vision).
        gain_unit: Unit of Gain: "dB", or "" for a factor without a unit (Chromasens).
        time_unit: Unit of ExposureTime and TriggerDelay: SFNC's is "us".
        whole_us: Step of ExposureTime and TriggerDelay where they are integers (aravis 98c2d790, arvcamera.c,
            arv_camera_set_exposure_time: XIMEA); 0: they are not.
        auto_gain: Gain at which automatic gain stands while it is on; it stays there when it is switched off.
        processing: Whether it has further features that change readings (`genicam_processing`).
        debouncer: Name of its debouncer, which is an integer where makers have it so: LineDebouncerTimeRaw (Point Grey
            Chameleon3), mvLineDebounceTimeRisingEdge (Balluff).
        debouncer_us: Its time at power-up, and its least value; None: it has none. A level counts once it has
            lasted for that long, so that edges act later by as much and shorter pulses are lost
            (docs.baslerweb.com/line-debouncer; Basler aviator's manual: 10 us by default).
        outputs: Lines on which the debouncer is not available (mvBlueFOX3-2032G, firmware 2.25, as arv-tool lists it).
        line_left: LineMode and LineInverter of each line, as another program has left them; None: it has no such
            features. An inverter turns edges round before anything else ("after any processing by the line inverter
            module", Teledyne Linea HS manual), and an output takes none.
        shutters: Entries of SensorShutterMode, that at power-up first; none: it has no such feature. Behind "Rolling"
            each quarter of the rows begins and ends later than the one above it, the last one by `readout_s`.
        link: DeviceLinkThroughputLimit in bytes a second and its mode, as another program has left them; None: it has
            no such features. "If a DeviceLinkThroughputLimit is set and the unlimited link speed exceeds the set limit,
            the acquisition frame rate would be adjusted" (Balluff CA-SF, Optimizing the bandwidth); triggers before
            that are lost, as before AcquisitionFrameRate allows them.
        packets: GevSCPD in ticks of 8 ns, as another program has left it, and GevSCPSPacketSize; None: it has no such
            features. The camera pauses so long after each packet (aravis, arv_camera_gv_set_packet_delay), which holds
            36 bytes that are no data.
        stream_limit: StreamBytesPerSecond, and StreamFrameRateConstrain (Allied Vision, GigE Camera and Drivers
            Features 2.0.0: "If False, frame rate is not limited to bandwidth"); None: it has none.
        tells_latency: Whether it tells `latency_s` as BslExposureStartDelay (docs.baslerweb.com/exposure-start-delay).
        tells_offset: Whether it tells the exposure with `exposure_offset_s` (docs.baslerweb.com/exposure-time:
            BslEffectiveExposureTime).
        rate_limits: AcquisitionFrameRate that another program has left on, and that limits ExposureTime (Teledyne DALSA
            FA-80, Camera Operation: "When adjusting the exposure time the range is limited by the frame rate"; KAYA
            JetCam19, 10.3); 0: none.
        base_us: ExposureTimeBaseAbs, as another program has left it: exposures are 1 to 4095 times as long (Basler
            scout GigE manual, 9.7); 0: it has none.
        delay_switch: Whether TriggerDelay has an effect only while TriggerDelayEnabled is on (Point Grey Chameleon3).
        exposure: Name of its exposure: Ricoh's is ExposureTimeRaw (arvcamera.c, arv_camera_set_exposure_time).
        latched: Where TimestampLatch puts the time: in TimestampLatchValue, or in Timestamp (Chameleon3, mvBlueFOX3).
        armed: Whether TriggerArmed tells that it waits for triggers, instead of AcquisitionStatus (Lucid, Arena SDK).
        left: Further features of triggers and streams, as another program has left them: see `_FURTHER`.
    """

    padding_bytes: int = 0
    transport: Literal["GEV", "U3V"] = "GEV"
    gated: bool = True
    stamped: bool = True
    chunks: bool = True
    tells: Literal["time", "rate", "allied", "balluff", "limit", "nothing"] = "time"
    least_delay_us: float = 0.0
    locks_triggers: bool = False
    has_activation: bool = True
    has_selector: bool = True
    goes_on: bool = False
    gain_unit: str = "dB"
    time_unit: Literal["us", "ms", "ns", "px"] = "us"
    whole_us: int = 0
    auto_gain: float = 0.0
    processing: bool = False
    debouncer: str = "LineDebouncerTime"
    debouncer_us: tuple[float, float] | None = None
    outputs: tuple[str, ...] = ()
    line_left: tuple[Literal["Input", "Output"], bool] | None = None
    shutters: tuple[str, ...] = ()
    link: tuple[int, Literal["On", "Off"]] | None = None
    packets: tuple[int, int] | None = None
    stream_limit: tuple[int, bool] | None = None
    tells_latency: bool = False
    tells_offset: bool = False
    rate_limits: float = 0.0
    base_us: float = 0.0
    delay_switch: bool = False
    exposure: str = "ExposureTime"
    latched: Literal["TimestampLatchValue", "Timestamp"] = "TimestampLatchValue"
    armed: bool = False
    left: dict[str, FeatureValue] = field(default_factory=dict)


TICKS_HZ = 125_000_000
_FURTHER = {
    "TriggerCacheEnable": lambda left: Node("boolean", left),
    "AcquisitionBurstFrameCount": lambda left: Node("integer", left, lambda: 1.0, lambda: 1023.0),
    "ExposureDelay": lambda left: Node("float", left, high=lambda: 5000.0, unit="us"),
    "SyncInGlitchFilter": lambda left: Node("integer", left, high=lambda: 50_000.0),
    "TriggerFilterTime": lambda left: Node("integer", left, high=lambda: 65_535.0),
    "LineDebounceMode": lambda left: Node("enumeration", left, symbols=("Off", "Deglitch"), selector="LineSelector"),
    "StreamHoldEnable": lambda left: Node("enumeration", left, symbols=("Off", "On")),
    "AcquisitionFrameRateMode": lambda left: Node("enumeration", left, symbols=("Off", "On")),
    "AcquisitionFrameRateTargetEnable": lambda left: Node("boolean", left),
    "ExposureTimeMode": lambda left: Node("enumeration", left, symbols=("Standard", "UltraShort")),
    "TransferControlMode": lambda left: Node("enumeration", left, symbols=("Basic", "Automatic", "UserControlled")),
    "SequenceEnable": lambda left: Node("boolean", left),
    "TriggerControlImplementation": lambda left: Node("enumeration", left, symbols=("Legacy", "Standard")),
}
"""Feature -> how it is made: Hikrobot's GigE manual, 9.7.4 (three triggers at most are kept) and 9.7.1 (frames of a
burst follow one trigger); Daheng's MERCURY2 manual, 8.2.11 (0 to 5000 us between trigger and exposure); AVT GigE Camera
Attributes 1.3.1 (about a nanosecond each, up to 50000); Imperx Cheetah manual; Allied Vision (a level has to last for
LineDebounceDuration, here 100 us; StreamHoldEnable keeps frames in the camera); Daheng's and IDS' switches of the frame
rate, here 25 Hz; Basler: ultra-short exposures end after 14 us at the latest, a sequencer locks what it changes and is
locked by automatic settings, and in a Legacy implementation a frame's trigger "is called Acquisition Start trigger"
(pylon, PLCamera); FLIR, Transfer Control: UserControlled keeps frames."""


def pack_pfnc(pixels: U16, name: str, padding_bytes: int = 0) -> bytes:
    """Pack pixels, [H, W] uint16, as a camera sends them; padding bytes are 0xA5."""
    packed = genicam.pack_pfnc(pixels if padding_bytes else pixels.reshape(1, -1), name)
    return np.pad(packed, ((0, 0), (0, padding_bytes)), constant_values=0xA5).tobytes()


class OddNodes(NodeTable):
    """Features that tests add to, some of them locked for another reason than streaming.

    Args:
        barred: Tells whether a feature is.
        absent: Tells whether a feature is not available now.
    """

    def __init__(
        self,
        nodes: dict[str, Node],
        streaming: Callable[[], bool],
        barred: Callable[[str], bool],
        absent: Callable[[str], bool],
    ) -> None:
        super().__init__(nodes, streaming)
        self._barred, self._absent = barred, absent
        self._at_power_up = {name: node.value for name, node in nodes.items()}

    def add(self, name: str, node: Node) -> None:
        """Give the camera a further feature."""
        self._nodes[name], self._at_power_up[name] = node, node.value

    def set_entries(self, name: str, symbols: tuple[str, ...]) -> None:
        """Give an enumeration other entries."""
        self._nodes[name].symbols = symbols

    def off(self) -> dict[str, Node]:
        """Return the features that are off their values at power-up, those of a selector's entries included."""
        return {
            name: self._nodes[name]
            for name, value in self._at_power_up.items()
            if name in self
            and any(one != value for one in (self._nodes[name].value, *self._nodes[name].by_entry.values()))
        }

    def describe(self, name: str) -> Feature | None:
        found = None if self._absent(name) else super().describe(name)
        return found and replace(found, writable=found.writable and not self._barred(name))

    def read(self, name: str) -> FeatureValue:
        if self._absent(name):
            raise FeatureRefusalError(f"{name} is not available now")
        return super().read(name)

    def write(self, name: str, value: FeatureValue) -> None:
        if self._barred(name) or self._absent(name):
            raise FeatureRefusalError(f"{name} is not writable now")
        super().write(name, value)


class GenicamTwin(genicam.GenicamTwin):
    """A camera of such a model."""

    model: GenicamModel
    nodes: OddNodes
    _made_shutter = OddShutter

    def __init__(self, world, model=None, faults=None, *, rng=None) -> None:  # type: ignore[no-untyped-def]
        super().__init__(world, model or GenicamModel(), faults, rng=rng)
        self._shutter.least_period_s, self._shutter.debounce_s = self._least_period_s, self._debounce_s
        self._shutter.keeps_edges = lambda: bool(self._left("TriggerCacheEnable", absent=False))
        self._shutter.burst = lambda: int(self._left("AcquisitionBurstFrameCount", absent=1))

    def _power_up(self) -> None:
        self.nodes = OddNodes(
            in_categories(self._make_nodes()),
            lambda: self.streaming,
            self._barred,
            lambda name: (
                bool(self.model.outputs)
                and name == self.model.debouncer
                and self.nodes.read("LineSelector") in self.model.outputs
            ),
        )

    def _barred(self, name: str) -> bool:
        """Return whether a feature is locked by another one."""
        if name in ("TriggerSource", "TriggerActivation", "TriggerDelay") and self.model.locks_triggers:
            return self.nodes.read("TriggerMode") == "On"
        if name == "SequenceEnable":
            return "Continuous" in (self.nodes.read("ExposureAuto"), self.nodes.read("GainAuto"))
        return name in (self.model.exposure, "Gain", "Width") and bool(self._left("SequenceEnable", absent=False))

    def write(self, name: str, value: FeatureValue) -> None:
        if self.model.base_us and name in ("ExposureTimeBaseAbs", self.model.exposure):
            exposure_us, base_us = self.nodes.number(self.model.exposure), self.nodes.number("ExposureTimeBaseAbs")
            bases = (float(value) if name == self.model.exposure else exposure_us) / base_us
            super().write(name, value)
            times = min(max(round(bases), 1), 4095) * self.nodes.number("ExposureTimeBaseAbs")
            self.nodes.write(self.model.exposure, min(max(times, 20.0), 10e6))
            return
        automatic = name == "GainAuto" and self.nodes.read(name) != "Off"
        super().write(name, value)
        if automatic and value == "Off":
            self.nodes.write("Gain", self.model.auto_gain)
        if (name, value) == ("TriggerControlImplementation", "Standard"):
            self.nodes.set_entries("TriggerSelector", genicam.TRIGGERS)

    def start(self, buffers: int, chunks: tuple[str, ...]) -> int:
        frames = self._frames
        given = super().start(buffers, chunks)
        self._frames = frames if self.model.goes_on else 0
        return given

    def _identity(self) -> CameraIdentity:
        return replace(super()._identity(), transport=self.model.transport)

    def _sent(self, pixels: U16, name: str, number: int, stamp: int, exposed: Exposed) -> CameraBuffer:
        model = self.model
        sent = super()._sent(pixels, name, number, stamp, exposed)
        return replace(
            sent,
            data=pack_pfnc(pixels, name, model.padding_bytes),
            padding_bytes=model.padding_bytes,
            frame_id=number if model.transport == "U3V" else sent.frame_id,
            timestamp=stamp if model.stamped else None,
        )

    def _chunks(self, stamp: int, exposed: Exposed) -> dict[str, float]:
        found = super()._chunks(stamp, exposed) if self.model.chunks else {}
        return {key: one for key, one in found.items() if self.model.stamped or key != "ChunkTimestamp"}

    def _active_low(self) -> bool:
        falling = self.model.has_activation and super()._active_low()
        return falling != bool(self._of_line("LineInverter", absent=False))

    def _wired(self) -> bool:
        return super()._wired() and self._of_line("LineMode", absent="Input") == "Input"

    def _of_line(self, name: str, *, absent: FeatureValue) -> FeatureValue:
        """Return a property of the trigger's line, or what holds where the camera has no such feature."""
        return self.nodes.of(name, self.model.trigger_input) if self.model.line_left else absent

    @property
    def _unit_s(self) -> float:
        return TIME_UNITS_S[self.model.time_unit]

    def _left(self, name: str, *, absent: FeatureValue) -> FeatureValue:
        """Return one of the further features, or what holds where the camera has none."""
        return self.nodes.of(name, self.model.trigger_input) if name in self.nodes else absent

    def _delay_s(self) -> float:
        on = not self.model.delay_switch or self.nodes.read("TriggerDelayEnabled")
        return (super()._delay_s() if on else 0.0) + float(self._left("ExposureDelay", absent=0.0)) * US

    def _exposure_s(self) -> float:
        return self.nodes.number(self.model.exposure) * self._unit_s

    def _debounce_s(self) -> float:
        model = self.model
        own_s = self.nodes.of_number(model.debouncer, model.trigger_input) * US if model.debouncer_us else 0.0
        glitch_s = 1e-9 * float(self._left("SyncInGlitchFilter", absent=0))
        filter_s = US * float(self._left("TriggerFilterTime", absent=0))
        return own_s + glitch_s + filter_s + 100 * US * (self._left("LineDebounceMode", absent="Off") != "Off")

    def _deliver(self, exposed: Exposed) -> None:
        held = self._left("TransferControlMode", absent="Basic") == "UserControlled"
        if self._left("StreamHoldEnable", absent="Off") == "Off" and not held:
            super()._deliver(exposed)

    def _least_period_s(self) -> float:
        model, nodes = self.model, self.nodes
        limited = "AcquisitionFrameRateEnable" in nodes and nodes.read("AcquisitionFrameRateEnable")
        periods_s = [1 / nodes.number("AcquisitionFrameRate") if limited else 0.0]
        if self._left("AcquisitionFrameRateMode", absent="Off") == "On" or self._left(
            "AcquisitionFrameRateTargetEnable", absent=False
        ):
            periods_s.append(1 / 25)
        if model.link and nodes.read("DeviceLinkThroughputLimitMode") != "Off":
            periods_s.append(self._payload_bytes() / nodes.number("DeviceLinkThroughputLimit"))
        if model.stream_limit and nodes.read("StreamFrameRateConstrain"):
            periods_s.append(self._payload_bytes() / nodes.number("StreamBytesPerSecond"))
        if model.packets:
            per_packet = nodes.number("GevSCPSPacketSize") - 36
            periods_s.append(self._payload_bytes() / per_packet * nodes.number("GevSCPD") / TICKS_HZ)
        return max(periods_s)

    def _payload_bytes(self) -> int:
        _, _, height, width = self.region
        name = str(self.nodes.read("PixelFormat"))
        return len(pack_pfnc(np.zeros((height, width), np.uint16), name, self.model.padding_bytes))

    def _integrate(self, exposed: Exposed, height: int, width: int, bits: int) -> U16:
        rolls = self.model.shutters and self.nodes.read("SensorShutterMode") == "Rolling"
        integrate = partial(self._world.integrate, height=height, width=width, bits=bits)
        return by_rows(exposed, self.model.readout_s if rolls else 0.0, height, integrate)

    def _processed(self, pixels: U16, top: int) -> U16:
        return process(pixels, top, self.nodes.off(), factor=self.model.gain_unit != "dB")

    def _highest_rate_hz(self) -> float:
        return 1 / max(self.model.own_period_s, self._exposure_s() + self.model.readout_s)

    def _make_nodes(self) -> dict[str, Node]:
        model, nodes = self.model, super()._make_nodes()
        if not model.gated:
            nodes["ExposureMode"].symbols = ("Timed",)
        if model.gain_unit != "dB":
            nodes["Gain"] = Node("float", 1.0, lambda: 1.0, lambda: 24.0, 0.1, unit=model.gain_unit)
        self._in_units(nodes)
        self._tell(nodes)
        self._line_up(nodes)
        self._limit(nodes)
        self._add_makers_own(nodes)
        if model.shutters:
            nodes["SensorShutterMode"] = Node("enumeration", model.shutters[0], symbols=model.shutters, locked=True)
        return nodes | (further_features() if model.processing else {})

    def _limit(self, nodes: dict[str, Node]) -> None:
        """Add what slows the link down."""
        model = self.model
        if model.link or model.packets or model.stream_limit:
            nodes["PayloadSize"] = Node("integer", fixed=True, read=self._payload_bytes)
        if model.link is not None:
            nodes["DeviceLinkThroughputLimit"] = Node(
                "integer", model.link[0], lambda: 1000.0, lambda: 400e6, locked=True, unit="Bps"
            )
            nodes["DeviceLinkThroughputLimitMode"] = Node("enumeration", model.link[1], symbols=("On", "Off"))
        if model.stream_limit is not None:
            limit, constrains = model.stream_limit
            nodes["StreamBytesPerSecond"] = Node("integer", limit, lambda: 1e6, lambda: 124e6)
            nodes["StreamFrameRateConstrain"] = Node("boolean", constrains)
        if model.packets is not None:
            ticks, size = model.packets
            nodes["GevSCPD"] = Node("integer", ticks, high=lambda: 1e6)
            nodes["GevSCPSPacketSize"] = Node("integer", size, lambda: 220.0, lambda: 9000.0)
            nodes["GevTimestampTickFrequency"] = Node("integer", TICKS_HZ, fixed=True)

    def _add_makers_own(self, nodes: dict[str, Node]) -> None:
        """Give features makers' own names, and add those that only some have."""
        model = self.model
        if model.tells_latency:
            nodes["BslExposureStartDelay"] = Node("float", model.latency_s / US, fixed=True, unit="us")
        if model.tells_offset:
            nodes["BslEffectiveExposureTime"] = Node(
                "float", fixed=True, read=lambda: (self._exposure_s() + model.exposure_offset_s) / US, unit="us"
            )
        if model.base_us:
            nodes["ExposureTimeBaseAbs"] = Node("float", model.base_us, lambda: 1.0, lambda: 10e6, 1.0, unit="us")
        if model.rate_limits:
            nodes["AcquisitionFrameRateEnable"] = Node("boolean", True)
            nodes["AcquisitionFrameRate"].value = model.rate_limits
        if model.delay_switch:
            nodes["TriggerDelayEnabled"] = Node("boolean", False)
        most_us = nodes["ExposureTime"].high
        nodes["ExposureTime"].high = lambda: min(most_us(), self._longest_us())
        nodes[model.exposure] = nodes.pop("ExposureTime")
        if model.stamped:
            nodes[model.latched] = nodes.pop("TimestampLatchValue")
        if model.armed:
            del nodes["AcquisitionStatusSelector"]
            nodes["TriggerArmed"] = nodes.pop("AcquisitionStatus")
        for name, left in model.left.items():
            nodes[name] = _FURTHER[name](left)
            nodes[name].category = "AcquisitionControl"
        if model.left.get("TriggerControlImplementation") == "Legacy":
            nodes["TriggerSelector"].symbols = ("AcquisitionStart",)
            nodes["TriggerSelector"].value = "AcquisitionStart"

    def _longest_us(self) -> float:
        """Return the longest exposure that other features leave, in microseconds."""
        limited = self.model.rate_limits and self.nodes.read("AcquisitionFrameRateEnable")
        rate_us = 1e6 / self.nodes.number("AcquisitionFrameRate") if limited else np.inf
        base_us = 4095 * self.nodes.number("ExposureTimeBaseAbs") if self.model.base_us else np.inf
        return min(
            rate_us, base_us, 14.0 if self._left("ExposureTimeMode", absent="Standard") == "UltraShort" else np.inf
        )

    def _in_units(self, nodes: dict[str, Node]) -> None:
        """Count times in the camera's unit."""
        model, per_us = self.model, US / self._unit_s
        for name, least_us, most_us, step_us in (
            ("ExposureTime", 20.0, 10e6, 0.5),
            ("TriggerDelay", model.least_delay_us, 1e6, 0.1),
        ):
            node, least = nodes[name], least_us * per_us
            node.value = max(float(node.value) * per_us, least)
            node.low, node.high = partial(float, least), partial(float, most_us * per_us)
            node.step, node.unit = step_us * per_us, model.time_unit
            if model.whole_us:
                node.kind, node.value, node.step = "integer", int(node.value), float(model.whole_us)

    def _tell(self, nodes: dict[str, Node]) -> None:
        """Leave out what the camera has not."""
        model = self.model
        if model.tells != "time":
            del nodes["SensorReadoutTime"]
        rates = {"rate": "ResultingFrameRate", "allied": "AcquisitionFrameRateLimit", "balluff": "mvResultingFrameRate"}
        if model.tells in rates:
            nodes[rates[model.tells]] = Node("float", fixed=True, read=self._highest_rate_hz)
        if model.tells == "balluff":
            del nodes["AcquisitionFrameRate"]
        if model.tells == "limit":
            nodes["AcquisitionFrameRate"].high = self._highest_rate_hz
        if not model.stamped:
            del nodes["TimestampLatch"], nodes["TimestampLatchValue"]
        if not model.chunks:
            del nodes["ChunkModeActive"], nodes["ChunkSelector"], nodes["ChunkEnable"]
        if not model.has_activation:
            del nodes["TriggerActivation"]
        if not model.has_selector:
            del nodes["TriggerSelector"]
            for node in nodes.values():
                node.selector = "" if node.selector == "TriggerSelector" else node.selector

    def _line_up(self, nodes: dict[str, Node]) -> None:
        """Add what the camera's lines can be set to."""
        model, inputs = self.model, nodes["TriggerSource"].symbols
        if model.debouncer_us is not None or model.line_left is not None or "LineDebounceMode" in model.left:
            nodes["LineSelector"] = Node("enumeration", inputs[1], symbols=inputs[1:], category="DigitalIOControl")
        if model.line_left is not None:
            way, inverted = model.line_left
            nodes["LineMode"] = Node("enumeration", way, symbols=("Input", "Output"), selector="LineSelector")
            nodes["LineInverter"] = Node("boolean", inverted, selector="LineSelector")
        if model.debouncer_us is not None:
            found_us, least_us = model.debouncer_us
            whole = model.debouncer.endswith("Raw") or model.debouncer.startswith(("mv", "line"))
            kind, step = ("integer", 1.0) if whole else ("float", 0.1)
            nodes[model.debouncer] = Node(
                *(kind, found_us, lambda: least_us, lambda: 20e3, step), selector="LineSelector", unit="us"
            )
