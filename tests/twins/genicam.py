"""GenICam cameras unlike the usual one of the simulated bench: in units, locks, lines, limits, chunks, shutters.

Their features and what these do follow SFNC 2.7 and the makers that are named. Here: `GenicamModel`, `GenicamTwin` as
those of `gs2ci_sims.wires.genicam`, with what a rig file cannot state. Not here: processing (`genicam_processing`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
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
            (mvBlueFOX3).
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

    padding_bytes: int = 0
    transport: Literal["GEV", "U3V"] = "GEV"
    gated: bool = True
    stamped: bool = True
    chunks: bool = True
    tells: Literal["time", "rate", "allied", "limit", "nothing"] = "time"
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
    debouncer_us: tuple[float, float] | None = None
    line_left: tuple[Literal["Input", "Output"], bool] | None = None
    shutters: tuple[str, ...] = ()
    link: tuple[int, Literal["On", "Off"]] | None = None


def pack_pfnc(pixels: U16, name: str, padding_bytes: int = 0) -> bytes:
    """Pack pixels, [H, W] uint16, as a camera sends them; padding bytes are 0xA5."""
    packed = genicam.pack_pfnc(pixels if padding_bytes else pixels.reshape(1, -1), name)
    return np.pad(packed, ((0, 0), (0, padding_bytes)), constant_values=0xA5).tobytes()


class OddNodes(NodeTable):
    """Features that tests add to, some of them locked for another reason than streaming.

    Args:
        barred: Tells whether a feature is.
    """

    def __init__(self, nodes: dict[str, Node], streaming: Callable[[], bool], barred: Callable[[str], bool]) -> None:
        super().__init__(nodes, streaming)
        self._barred = barred
        self._at_power_up = {name: node.value for name, node in nodes.items()}

    def add(self, name: str, node: Node) -> None:
        """Give the camera a further feature."""
        self._nodes[name], self._at_power_up[name] = node, node.value

    def off(self) -> dict[str, Node]:
        """Return the features that are off their values at power-up, those of a selector's entries included."""
        return {
            name: self._nodes[name]
            for name, value in self._at_power_up.items()
            if name in self
            and any(one != value for one in (self._nodes[name].value, *self._nodes[name].by_entry.values()))
        }

    def describe(self, name: str) -> Feature | None:
        found = super().describe(name)
        return found and replace(found, writable=found.writable and not self._barred(name))

    def write(self, name: str, value: FeatureValue) -> None:
        if self._barred(name):
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

    def _power_up(self) -> None:
        self.nodes = OddNodes(
            in_categories(self._make_nodes()),
            lambda: self.streaming,
            lambda name: (
                self.model.locks_triggers
                and name in ("TriggerSource", "TriggerActivation", "TriggerDelay")
                and self.nodes.read("TriggerMode") == "On"
            ),
        )

    def write(self, name: str, value: FeatureValue) -> None:
        automatic = name == "GainAuto" and self.nodes.read(name) != "Off"
        super().write(name, value)
        if automatic and value == "Off":
            self.nodes.write("Gain", self.model.auto_gain)

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

    def _debounce_s(self) -> float:
        if self.model.debouncer_us is None:
            return 0.0
        return self.nodes.of_number("LineDebouncerTime", self.model.trigger_input) * US

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
        if model.link is not None:
            nodes["PayloadSize"] = Node("integer", fixed=True, read=self._payload_bytes)
            nodes["DeviceLinkThroughputLimit"] = Node(
                "integer", model.link[0], lambda: 1000.0, lambda: 400e6, locked=True, unit="Bps"
            )
            nodes["DeviceLinkThroughputLimitMode"] = Node("enumeration", model.link[1], symbols=("On", "Off"))
        if model.shutters:
            nodes["SensorShutterMode"] = Node("enumeration", model.shutters[0], symbols=model.shutters, locked=True)
        return nodes | (further_features() if model.processing else {})

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
        if model.tells in ("rate", "allied"):
            name = "ResultingFrameRate" if model.tells == "rate" else "AcquisitionFrameRateLimit"
            nodes[name] = Node("float", fixed=True, read=self._highest_rate_hz)
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
