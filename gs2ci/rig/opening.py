"""From a rig file to open devices: the only file that chooses between a device and its twin.

Here: drivers on real ports or on twins, and wire traces around either. Not here: the world of the twins
(`gs2ci.rig.simulated`), the contents of a rig file (`config`).
"""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from gs2ci.core.clock import Clock, WallClock
from gs2ci.core.errors import InputError
from gs2ci.rig.config import DEVICE_GROUPS, RigTable, read_rig
from gs2ci.rig.session import SessionLog
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.plugin import PortKind, known_driver
from gs2ci_drivers.ports import port_errors
from gs2ci_drivers.trace import CallLog, Trace, TracedLibrary, TracedPort, TracedStream, TracedSys
from gs2ci_drivers.trace_camera import TracedCamera

if TYPE_CHECKING:
    from gs2ci.rig.simulated import SimulatedBench


# Twins of these ports are ports themselves, since devices of these kinds are opened by calls on the port.
_TWINS_THEMSELVES: Final = ("sys", "camera", "screen")
_TRACED: Final[dict[PortKind, type[TracedPort]]] = {
    "bytes": TracedStream,
    "hid": TracedStream,
    "sys": TracedSys,
    "camera": TracedCamera,
    "library": TracedLibrary,
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

    def set_seed(self, seed: int) -> None:
        """Set the seed of the random masks, instead of the file's: fresh masks for another exposure.

        Raises:
            InputError: Below 0, or the masks are those of a file.
        """
        if seed < 0:
            raise InputError(f"--seed {seed}", allowed="0 or more")
        if self.table.capture.pattern_file:
            raise InputError(
                f"--seed {seed} with pattern_file = {self.table.capture.pattern_file!r} in [capture]",
                allowed="random masks",
                remedy="leave --seed out, or take pattern_file out of the rig file",
            )
        self.table = self.table.model_copy(update={"capture": self.table.capture.model_copy(update={"seed": seed})})

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
        one = known_driver(DEVICE_GROUPS[device], table.kind)
        twin = None if self.bench is None else getattr(self.bench, device)
        if twin is None:
            port: Any = one.port(device, table)
        elif one.port_kind in _TWINS_THEMSELVES:
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
