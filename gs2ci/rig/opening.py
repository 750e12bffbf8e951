"""From a rig file to open devices: the only file that chooses between a device and its twin.

Here: drivers on real ports or on twins, and wire traces around either. Not here: the world of the twins
(`gs2ci.rig.simulated`), the contents of a rig file (`config`).
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gs2ci.core.clock import Clock, WallClock
from gs2ci.core.errors import InputError
from gs2ci.rig.config import DEVICE_GROUPS, RigTable, read_rig
from gs2ci.rig.session import SessionLog
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.display_slm.driver import DisplaySlm
from gs2ci_drivers.display_slm.options import DisplaySlmOptions
from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.packets import PRODUCT_ID, VENDOR_ID
from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.links.gentl import GenTlPort
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.links.serial_line import SerialLine
from gs2ci_drivers.links.usb_bulk import UsbFifo
from gs2ci_drivers.links.usb_hid import UsbHid
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.plugin import driver_plugin
from gs2ci_drivers.ports import BytePort, CameraPort, HidPort, ScreenPort, SysPort, port_errors
from gs2ci_drivers.scpi_modulator.driver import ScpiModulator
from gs2ci_drivers.sensor import Sensor
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.trace import CallLog, Trace, TracedBytes, TracedHid, TracedSys
from gs2ci_drivers.trace_camera import TracedCamera
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions

if TYPE_CHECKING:
    from gs2ci.rig.simulated import SimulatedBench

T = TypeVar("T")


@dataclass
class Rig:
    """A rig, not open yet.

    Args:
        table: The contents of its file.
        text: The file, word for word.
        folder: Where the file lies.
        bench: The simulated surroundings, or None for a real bench. They outlive the devices' sessions.
    """

    table: RigTable
    text: str
    folder: Path
    bench: "SimulatedBench | None" = None

    @property
    def clock(self) -> Clock:
        """Get the clock on which this rig's devices wait."""
        return self.bench.world.clock if self.bench else WallClock()

    def set_shots(self, shots: int) -> None:
        """Set the number of shots, instead of the file's.

        Raises:
            InputError: Not 1 or more.
        """
        if shots < 1:
            raise InputError(f"--shots {shots}", allowed="1 or more")
        capture = self.table.capture.model_copy(update={"shots": shots})
        self.table = self.table.model_copy(update={"capture": capture})

    def open(self, trace_stem: Path | None = None, session: SessionLog | None = None) -> Devices:
        """Open all devices; nothing is sent to them yet.

        Args:
            trace_stem: Where wire traces go: `<stem>.<device>.wire`; None writes none.
            session: The log that records every call at its level "debug".

        Raises:
            AccessError, DisconnectedError: A port cannot be opened; those already open are closed again.
        """
        clock = self.clock
        with ExitStack() as opened:
            traces = _Traces(trace_stem, clock, session)
            opened.callback(traces.close)
            modulator = opened.enter_context(closing(self._modulator(clock, traces)))
            sensor = opened.enter_context(closing(self._sensor(clock, traces)))
            stage = self._stage(clock, traces)
            opened.pop_all()
        return Devices(modulator, sensor, stage, clock, (traces.close,))

    def _modulator(self, clock: Clock, traces: "_Traces") -> Modulator:
        table = self.table.modulator
        plugged = self._plugged("modulator", table, clock, traces)
        if plugged is not None:
            return plugged  # type: ignore[no-any-return]
        if isinstance(table, Dlpc900Options):
            return Dlpc900("modulator", traces.hid("modulator", self._hid_port(table)), clock, table)
        if isinstance(table, DisplaySlmOptions):
            return DisplaySlm("modulator", traces.bytes("modulator", self._fifo(table)), clock, table)
        if isinstance(table, VideoOutOptions):
            screen: ScreenPort = self.bench.modulator if self.bench else SdlScreen("modulator")  # type: ignore[assignment]
            return VideoOut("modulator", screen, clock, table)
        line = self._line("modulator", table.port, table.baud, traces)
        return ScpiModulator("modulator", line, clock, table)

    def _plugged(self, device: str, table: Any, clock: Clock, traces: "_Traces") -> Any:
        """Open a device of another package; None for a built-in one."""
        plugin = driver_plugin(DEVICE_GROUPS[device], table.kind)
        if plugin is None:
            return None
        twin = getattr(self.bench, device, None)
        port: Any = plugin.port(device, table) if twin is None else _opened(device, twin.open)
        wrap: Any = {"bytes": traces.bytes, "hid": traces.hid, "sys": traces.sys}[plugin.port_kind]
        return plugin.driver(device, wrap(device, port), clock, table)

    def _hid_port(self, table: Dlpc900Options) -> HidPort:
        if self.bench is not None:
            return _opened("modulator", self.bench.modulator.open)  # type: ignore[return-value]
        return UsbHid("modulator", VENDOR_ID, PRODUCT_ID, bus_port=_bus_port(table.port))

    def _fifo(self, table: DisplaySlmOptions) -> BytePort:
        if self.bench is not None:
            return _opened("modulator", self.bench.modulator.open)  # type: ignore[return-value]
        return UsbFifo("modulator", bus_port=_bus_port(table.port))

    def _sensor(self, clock: Clock, traces: "_Traces") -> Sensor:
        plugged = self._plugged("sensor", self.table.sensor, clock, traces)
        if plugged is not None:
            return plugged  # type: ignore[no-any-return]
        table = self.table.sensor
        if isinstance(table, GenicamOptions):
            camera: CameraPort = self.bench.sensor if self.bench else GenTlPort("sensor")  # type: ignore[assignment]
            return GenicamSensor("sensor", traces.camera("sensor", camera), clock, table)
        port: SysPort = self.bench.sensor if self.bench else KernelSysPort()  # type: ignore[assignment]
        return V4l2Sensor("sensor", traces.sys("sensor", port), clock, table)

    def _stage(self, clock: Clock, traces: "_Traces") -> Stage | None:
        table = self.table.stage
        if table is None:
            return None
        plugged = self._plugged("stage", table, clock, traces)
        if plugged is not None:
            return plugged  # type: ignore[no-any-return]
        line = self._line("stage", table.port, table.baud, traces)
        if isinstance(table, ZaberOptions):
            return ZaberStage("stage", line, clock, table)
        return GrblStage("stage", line, clock, table)

    def _line(self, device: str, path: str, baud: int, traces: "_Traces") -> BytePort:
        if self.bench is not None:
            twin = self.bench.stage if device == "stage" else self.bench.modulator
            assert twin is not None  # the bench makes a twin for every such table
            line: BytePort = _opened(device, twin.open)  # type: ignore[assignment]
        else:
            line = SerialLine(device, path, baud)
        return traces.bytes(device, line)


def load_rig(path: Path) -> Rig:
    """Read a rig file and build the surroundings of simulated devices; nothing is opened.

    Raises:
        InputError: As `gs2ci.rig.config.read_rig` and `gs2ci.rig.simulated.build_bench`.
    """
    table, text = read_rig(path)
    if not table.simulated:
        return Rig(table, text, path.parent)
    # Imported here because a real bench does not need the simulator.
    from gs2ci.rig.simulated import build_bench  # noqa: PLC0415

    return Rig(table, text, path.parent, build_bench(table))


def _bus_port(port: str) -> str:
    """Return the bus address of a USB device: the part after "usb:"."""
    return port.removeprefix("usb").removeprefix(":")


def _opened(device: str, action: Callable[[], T]) -> T:
    with port_errors(device, "open"):
        return action()


class _Traces:
    """Wire traces around ports, if they are requested."""

    def __init__(self, stem: Path | None, clock: Clock, session: SessionLog | None) -> None:
        self._stem = stem
        self._clock = clock
        self._session = session
        self._traces: list[Trace] = []

    def hid(self, device: str, port: HidPort) -> HidPort:
        for log in self._logs(device, "hid"):
            port = TracedHid(port, log)
        return port

    def bytes(self, device: str, port: BytePort) -> BytePort:
        for log in self._logs(device, "bytes"):
            port = TracedBytes(port, log)
        return port

    def sys(self, device: str, port: SysPort) -> SysPort:
        for log in self._logs(device, "sys"):
            port = TracedSys(port, log)
        return port

    def camera(self, device: str, port: CameraPort) -> CameraPort:
        for log in self._logs(device, "camera"):
            port = TracedCamera(port, log)
        return port

    def close(self) -> None:
        for trace in self._traces:
            trace.close()

    def _logs(self, device: str, port: str) -> Iterator[CallLog]:
        if self._stem is not None:
            yield self._new_trace(self._stem, device, port)
        wire = None if self._session is None else self._session.wire(device, self._clock)
        if wire is not None:
            yield wire

    def _new_trace(self, stem: Path, device: str, port: str) -> Trace:
        trace = Trace(stem.with_name(f"{stem.name}.{device}.wire"), device, port, self._clock)
        self._traces.append(trace)
        return trace
