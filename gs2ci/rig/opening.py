"""From a rig file to open devices: the only file that chooses between a device and its twin.

Here: drivers on real ports or on twins, and wire traces around either. Not here: the world of the twins
(`gs2ci.rig.simulated`), the contents of a rig file (`config`).
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

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
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.links.gentl import GenTlPort
from gs2ci_drivers.links.sdl_screen import SdlScreen
from gs2ci_drivers.links.serial_line import SerialLine
from gs2ci_drivers.links.usb_bulk import UsbFifo
from gs2ci_drivers.links.usb_hid import UsbHid
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.plugin import DriverPlugin, PortKind, driver_plugin
from gs2ci_drivers.ports import port_errors
from gs2ci_drivers.scpi_modulator.driver import ScpiModulator
from gs2ci_drivers.scpi_modulator.options import ScpiOptions
from gs2ci_drivers.trace import CallLog, Trace, TracedBytes, TracedHid, TracedSys
from gs2ci_drivers.trace_camera import TracedCamera
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.video_out.driver import VideoOut
from gs2ci_drivers.video_out.options import VideoOutOptions
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions

if TYPE_CHECKING:
    from gs2ci.rig.simulated import SimulatedBench


def _bus_port(port: str) -> str:
    """Return the bus address of a USB device: the part after "usb:"."""
    return port.removeprefix("usb").removeprefix(":")


def _line(device: str, table: Any) -> SerialLine:
    return SerialLine(device, table.port, table.baud)


def _hid(device: str, table: Dlpc900Options) -> UsbHid:
    return UsbHid(device, VENDOR_ID, PRODUCT_ID, bus_port=_bus_port(table.port))


def _fifo(device: str, table: DisplaySlmOptions) -> UsbFifo:
    return UsbFifo(device, bus_port=_bus_port(table.port))


DRIVERS: Final[dict[str, DriverPlugin]] = {
    "dlpc900": DriverPlugin(Dlpc900Options, _hid, Dlpc900, "hid"),
    "scpi": DriverPlugin(ScpiOptions, _line, ScpiModulator),
    "santec": DriverPlugin(DisplaySlmOptions, _fifo, DisplaySlm),
    "video": DriverPlugin(VideoOutOptions, lambda device, _: SdlScreen(device), VideoOut, "screen"),
    "v4l2": DriverPlugin(V4l2Options, lambda *_: KernelSysPort(), V4l2Sensor, "sys"),
    "genicam": DriverPlugin(GenicamOptions, lambda device, _: GenTlPort(device), GenicamSensor, "camera"),
    "zaber": DriverPlugin(ZaberOptions, _line, ZaberStage),
    "grbl": DriverPlugin(GrblOptions, _line, GrblStage),
}
"""Kind of a built-in device -> its port and its driver."""
# Twins of these ports are ports themselves, since devices of these kinds are opened by calls on the port.
_TWINS_THEMSELVES: Final = ("sys", "camera", "screen")
_TRACED: Final[dict[PortKind, Callable[[Any, CallLog], Any]]] = {
    "bytes": TracedBytes,
    "hid": TracedHid,
    "sys": TracedSys,
    "camera": TracedCamera,
}


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
        """Set the number of shots, instead of the file's; a longer burst becomes as short.

        Raises:
            InputError: Not 1 or more.
        """
        if shots < 1:
            raise InputError(f"--shots {shots}", allowed="1 or more")
        burst = min(self.table.capture.burst, shots)
        capture = self.table.capture.model_copy(update={"shots": shots, "burst": burst})
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
            table = self.table
            modulator = opened.enter_context(closing(self._device("modulator", table.modulator, clock, traces)))
            sensor = opened.enter_context(closing(self._device("sensor", table.sensor, clock, traces)))
            stage = None if table.stage is None else self._device("stage", table.stage, clock, traces)
            opened.pop_all()
        return Devices(modulator, sensor, stage, clock, (traces.close,))

    def _device(self, device: str, table: Any, clock: Clock, traces: "_Traces") -> Any:
        """Make a device's driver on its port, real or the twin's."""
        plugin = driver_plugin(DEVICE_GROUPS[device], table.kind)
        one = plugin or DRIVERS[table.kind]
        twin = None if self.bench is None else getattr(self.bench, device)
        if twin is None:
            port: Any = one.port(device, table)
        elif plugin is None and one.port_kind in _TWINS_THEMSELVES:
            port = twin
        else:
            with port_errors(device, "open"):
                port = twin.open()
        return one.driver(device, traces.around(device, one.port_kind, port), clock, table)


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


class _Traces:
    """Wire traces around ports, if they are requested."""

    def __init__(self, stem: Path | None, clock: Clock, session: SessionLog | None) -> None:
        self._stem = stem
        self._clock = clock
        self._session = session
        self._traces: list[Trace] = []

    def around(self, device: str, kind: PortKind, port: Any) -> Any:
        """Return a port that writes down what passes; a screen's pictures are not written down."""
        for log in self._logs(device, kind) if kind in _TRACED else ():
            port = _TRACED[kind](port, log)
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
