"""Record every byte that passes a port to a file.

A trace is a text file of JSON lines: a head (`{"trace": "gs2ci.wire/1", "device": ..., "port": ...}`), then one
line per call on the port with its time, its arguments, its result, or the error.

Here: the file's format, the recording wrappers. Not here: playing it back (`tests/drivers/replay.py`), the
ports' contract (`gs2ci_drivers.ports`).
"""

import base64
import inspect
import json
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TextIO, TypeVar

from gs2ci.core.clock import Clock
from gs2ci.core.errors import StorageError, reason_of
from gs2ci_drivers.ports import FeatureRefusalError

T = TypeVar("T")

SCHEMA = "gs2ci.wire/1"
# A replay waits for nothing, and its memory is another.
_LEFT_OUT = ("timeout_s", "mapping")
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
        except FeatureRefusalError as error:
            call.error = str(error)
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


class TracedPort:
    """A port that writes down what passes: each call of a method, with what goes in and what comes out.

    Of what goes in, bytes are noted as sent, and all else as arguments; timeouts and mapped memory are left out.

    Args:
        port: The port.
        trace: Where it is written down.
    """

    def __init__(self, port: Any, trace: CallLog) -> None:
        self._port = port
        self._trace = trace

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._port, name)

        def noted(*given: Any, **named: Any) -> Any:
            call = Call(name)
            for said, value in inspect.signature(method).bind(*given, **named).arguments.items():
                if isinstance(value, bytes | bytearray):
                    call.sent.append(bytes(value))
                elif said not in _LEFT_OUT:
                    call.args += value if isinstance(value, tuple) else [value]
            return self._trace.note(call, lambda: method(*given, **named), lambda result: self._outcome(call, result))

        return noted

    def _outcome(self, call: Call, result: Any) -> None:
        call.returned(result)


class TracedStream(TracedPort):
    """A `BytePort` or a `HidPort` that writes down what passes."""

    def close(self) -> None:
        """Close port and trace."""
        self._port.close()
        self._trace.close()


class TracedLibrary(TracedPort):
    """A `LibraryPort` that writes down what passes."""

    def call(self, function: str, numbers: Sequence[int], data: bytes = b"") -> int:
        """Call and note."""
        call = Call(function, args=list(numbers), sent=[data] if data else [])
        return self._trace.note(call, lambda: self._port.call(function, numbers, data))

    def ask(self, function: str, numbers: Sequence[int]) -> tuple[int, int]:
        """Ask and note the code, and the number that was written."""
        call = Call(function, args=list(numbers))
        return self._trace.note(
            call, lambda: self._port.ask(function, numbers), lambda found: call.returned([str(one) for one in found])
        )


class TracedSys(TracedPort):
    """A `SysPort` that writes down what passes, pixels included."""

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Call and note the memory before and after."""
        parts = [argument] if payload is None else [argument, payload]
        call = Call("ioctl", args=[fd, request], sent=[bytes(part) for part in parts])

        def outcome(result: int) -> None:
            call.result = result
            call.got = [bytes(part) for part in parts]

        return self._trace.note(call, lambda: self._port.ioctl(fd, request, argument, payload), outcome)
