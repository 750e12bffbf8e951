"""Record every byte that passes a port to a file.

A trace is a text file of JSON lines: a head (`{"trace": "gs2ci.wire/1", "device": ..., "port": ...}`), then one
line per call on the port with its time, its arguments, its result, or the error.

Here: the file's format, the recording wrappers. Not here: playing it back (`tests/drivers/replay.py`), the
ports' contract (`gs2ci_drivers.ports`).
"""

import base64
import json
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TextIO, TypeVar

from gs2ci.core.clock import Clock
from gs2ci.core.errors import StorageError, reason_of
from gs2ci_drivers.ports import BytePort, HidPort, LibraryPort, MappedMemory, SysPort

T = TypeVar("T")
Port = TypeVar("Port")

SCHEMA = "gs2ci.wire/1"
_PACK_FROM_BYTES = 256
"""Longer blocks (frames, patterns) are deflated; shorter ones stay readable as hex."""


def _packed(data: bytes) -> str:
    if len(data) < _PACK_FROM_BYTES:
        return data.hex()
    return "z" + base64.b64encode(zlib.compress(data, level=1)).decode("ascii")


@dataclass
class Call:
    """One call on a port.

    Args:
        op: The port's method.
        args: Numbers and names passed in; timeouts are left out, since a replay does not need them.
        sent: Bytes passed in.
        got: Bytes returned.
        result: A number or a list of names returned.
        errno: The error's number, 0 for a write that timed out, None if there was no error.
        error: The error's text.
        t_s: The clock's time when the call had returned.
    """

    op: str
    args: list[int | str] = field(default_factory=list)
    sent: list[bytes] = field(default_factory=list)
    got: list[bytes] = field(default_factory=list)
    result: int | list[str] | None = None
    errno: int | None = None
    error: str = ""
    t_s: float = 0.0

    def returned(self, result: object) -> None:
        """Put in what was returned: bytes, a number or names; other objects are not noted."""
        if isinstance(result, bytes):
            self.got.append(result)
        elif isinstance(result, int | list):
            self.result = result

    def to_line(self) -> str:
        """Return the call as one line of JSON, leaving out what is empty."""
        row: dict[str, Any] = {"t": round(self.t_s, 9), "op": self.op}
        optional = {
            "args": self.args,
            "sent": [_packed(data) for data in self.sent],
            "got": [_packed(data) for data in self.got],
            "result": self.result,
            "errno": self.errno,
            "error": self.error,
        }
        row.update({key: value for key, value in optional.items() if value not in ([], None, "")})
        return json.dumps(row)


class CallLog(Protocol):
    """Writes down calls on a port."""

    clock: Clock
    """The clock whose times are written down."""

    def put(self, call: Call) -> None:
        """Write down a call that has returned."""
        ...

    def close(self) -> None:
        """Write no more; a second call does nothing."""
        ...

    def note(self, call: Call, action: Callable[[], T], outcome: Callable[[T], None] | None = None) -> T:
        """Run `action`, let `outcome` put its result into `call`, write the call down, pass on the result or error.

        Without `outcome`, `Call.returned` does so.
        """
        try:
            result = action()
            (outcome or call.returned)(result)
        except OSError as error:
            call.errno, call.error = (0 if isinstance(error, TimeoutError) else error.errno or -1), str(error)
            raise
        else:
            return result
        finally:
            call.t_s = self.clock.now_s()
            self.put(call)


class Trace(CallLog):
    """A trace being written, line by line and flushed, so that a crash loses nothing.

    Args:
        path: The file; its folder must exist.
        device: Name of the device.
        port: Which port ("hid", "bytes", "sys").
        clock: The clock whose times are noted.

    Raises:
        StorageError: The file cannot be written, now or, from `note`, at any call; it is then closed, and calls pass
            without being noted.
    """

    def __init__(self, path: Path, device: str, port: str, clock: Clock) -> None:
        self.clock = clock
        self._path = path
        try:
            self._file: TextIO = path.open("w", encoding="ascii", buffering=1)
        except OSError as error:
            raise self._refused(error) from error
        self._write(json.dumps({"trace": SCHEMA, "device": device, "port": port}))

    def put(self, call: Call) -> None:
        """Write a call as one line."""
        if not self._file.closed:
            self._write(call.to_line())

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        with suppress(OSError):  # a full disk was already reported when a line was written
            self._file.close()

    def _write(self, line: str) -> None:
        try:
            self._file.write(line + "\n")
        except OSError as error:
            self.close()
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> StorageError:
        """Make an error that cannot be mistaken for one of the port."""
        return StorageError(
            f"the wire trace {self._path} cannot be written ({reason_of(error)})",
            remedy="check the folder and its free space, or set trace = false in the rig file",
        )


class TracedPort(Generic[Port]):
    """A port that writes down what passes.

    Args:
        port: The port.
        trace: Where it is written down.
    """

    def __init__(self, port: Port, trace: CallLog) -> None:
        self._port = port
        self._trace = trace


class TracedHid(TracedPort[HidPort]):
    """A `HidPort` that writes down what passes."""

    def write(self, report: bytes, timeout_s: float) -> None:
        """Send one report and note it."""
        self._trace.note(Call("write", sent=[report]), lambda: self._port.write(report, timeout_s))

    def read(self, timeout_s: float) -> bytes:
        """Receive one report and note it."""
        return self._trace.note(Call("read"), lambda: self._port.read(timeout_s))

    def close(self) -> None:
        """Close port and trace."""
        self._port.close()
        self._trace.close()


class TracedBytes(TracedPort[BytePort]):
    """A `BytePort` that writes down what passes."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send and note."""
        self._trace.note(Call("write", sent=[data]), lambda: self._port.write(data, timeout_s))

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Receive and note."""
        return self._trace.note(Call("read", args=[max_bytes]), lambda: self._port.read(max_bytes, timeout_s))

    def close(self) -> None:
        """Close port and trace."""
        self._port.close()
        self._trace.close()


class TracedLibrary(TracedPort[LibraryPort]):
    """A `LibraryPort` that writes down what passes."""

    def call(self, function: str, numbers: Sequence[int], data: bytes = b"") -> int:
        """Call and note."""
        call = Call(function, args=list(numbers), sent=[data] if data else [])
        return self._trace.note(call, lambda: self._port.call(function, numbers, data))

    def ask(self, function: str, numbers: Sequence[int]) -> tuple[int, int]:
        """Ask and note the code, and the number that was written."""
        call = Call(function, args=list(numbers))
        return self._trace.note(
            call,
            lambda: self._port.ask(function, numbers),
            lambda found: call.returned([str(found[0]), str(found[1])]),
        )

    def close(self) -> None:
        """Close and note."""
        self._trace.note(Call("close"), self._port.close)


class TracedSys(TracedPort[SysPort]):
    """A `SysPort` that writes down what passes, pixels included."""

    def open(self, path: str) -> int:
        """Open and note."""
        return self._trace.note(Call("open", args=[path]), lambda: self._port.open(path))

    def close(self, fd: int) -> None:
        """Close and note."""
        self._trace.note(Call("close", args=[fd]), lambda: self._port.close(fd))

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Call and note the memory before and after."""
        parts = [argument] if payload is None else [argument, payload]
        call = Call("ioctl", args=[fd, request], sent=[bytes(part) for part in parts])

        def outcome(result: int) -> None:
            call.result = result
            call.got = [bytes(part) for part in parts]

        return self._trace.note(call, lambda: self._port.ioctl(fd, request, argument, payload), outcome)

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Map and note that it was done."""
        call = Call("mmap", args=[fd, length, offset])
        return self._trace.note(call, lambda: self._port.mmap(fd, length, offset), lambda mapping: None)

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Copy and note the bytes."""
        return self._trace.note(Call("copy_out", args=[length]), lambda: self._port.copy_out(mapping, length))

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Wait and note what came."""
        return self._trace.note(Call("poll", args=[fd, events]), lambda: self._port.poll(fd, events, timeout_s))

    def clock_ns(self) -> int:
        """Get the kernel's time and note it: frames' times are compared with it."""
        return self._trace.note(Call("clock_ns"), self._port.clock_ns)

    def list_nodes(self, pattern: str) -> list[str]:
        """List and note."""
        return self._trace.note(Call("list_nodes", args=[pattern]), lambda: self._port.list_nodes(pattern))

    def read_file(self, path: str) -> bytes:
        """Read and note."""
        return self._trace.note(Call("read_file", args=[path]), lambda: self._port.read_file(path))

    def write_file(self, path: str, data: bytes) -> None:
        """Write and note."""
        call = Call("write_file", args=[path], sent=[data])
        self._trace.note(call, lambda: self._port.write_file(path, data))
