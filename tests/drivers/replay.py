"""Play a recorded wire trace back to a driver.

A replay answers a driver from the file call by call and refuses as soon as the driver does something else than
was recorded; its clock shows the recorded times, so that deadlines run out where they ran out then.

Here: the replaying ports. Not here: the file's format and recording (`gs2ci_drivers.trace`). Nothing here is a test.
"""

import base64
import json
import zlib
from pathlib import Path

from gs2ci.core.errors import InputError
from gs2ci_drivers.ports import MappedMemory
from gs2ci_drivers.trace import SCHEMA, Call


def call_of(line: str) -> Call:
    """Read one recorded call.

    Raises:
        ValueError, KeyError, TypeError, zlib.error: Not such a line.
    """
    row = json.loads(line)
    return Call(
        op=row["op"],
        args=row.get("args", []),
        sent=[_unpacked(text) for text in row.get("sent", [])],
        got=[_unpacked(text) for text in row.get("got", [])],
        result=row.get("result"),
        errno=row.get("errno"),
        error=row.get("error", ""),
        t_s=float(row["t"]),
    )


def _unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text[1:])) if text.startswith("z") else bytes.fromhex(text)


class Replay:
    """A recorded trace, answered call by call; also the clock that goes with it.

    Args:
        path: The trace file.

    Raises:
        InputError: Not a trace, or of another schema. A last line cut short by a crash is dropped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            lines = path.read_text(encoding="ascii").splitlines()
            head = json.loads(lines[0])
            if head["trace"] != SCHEMA:
                raise ValueError(head["trace"])
        except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
            raise InputError(
                f"{path} is not a wire trace ({error})", allowed=f"JSON lines of schema {SCHEMA}"
            ) from error
        self.device: str = head["device"]
        self.port: str = head["port"]
        self._calls = [self._parsed(number, line, len(lines)) for number, line in enumerate(lines[1:], 2)]
        self._next = 0
        self._now_s = next((call.t_s for call in self._calls if call), 0.0)

    def now_s(self) -> float:
        """Get the recorded time of the last call that was played, plus what was slept since."""
        return self._now_s

    def sleep_s(self, duration_s: float) -> None:
        """Let the replay's clock go on."""
        self._now_s += max(duration_s, 0.0)

    @property
    def finished(self) -> bool:
        """Get whether every recorded call was played."""
        return self._next >= len(self._calls) or self._calls[self._next] is None

    def play(self, wanted: Call) -> Call:
        """Return what was recorded for this call.

        Raises:
            InputError: The driver does something else than was recorded, or the trace is at its end.
            OSError: As recorded.
        """
        call = self._calls[self._next] if self._next < len(self._calls) else None
        if call is None or not _same(call, wanted):
            was = "its end" if call is None else f"{call.op} {call.args} {[data.hex() for data in call.sent]}"
            now = f"{wanted.op} {wanted.args} {[data.hex() for data in wanted.sent]}"
            raise InputError(
                f"{self._path} line {self._next + 2}: recorded was {was[:200]}, the driver does {now[:200]}",
                remedy="replay a trace with the driver version and the settings that recorded it",
            )
        self._next += 1
        self._now_s = max(self._now_s, call.t_s)
        if call.errno == 0:
            raise TimeoutError(call.error)
        if call.errno is not None:
            raise OSError(call.errno, call.error)
        return call

    def _parsed(self, number: int, line: str, total: int) -> Call | None:
        try:
            return call_of(line)
        except (ValueError, KeyError, TypeError, zlib.error) as error:
            if number == total:
                return None
            raise InputError(f"{self._path} line {number} is not a recorded call ({error})") from error


def _same(recorded: Call, wanted: Call) -> bool:
    """Compare two calls; where there is a payload its address stands in the argument, so only it counts."""
    if (recorded.op, recorded.args) != (wanted.op, wanted.args):
        return False
    if wanted.op == "ioctl" and len(wanted.sent) == 2:
        return recorded.sent[1:] == wanted.sent[1:]
    return recorded.sent == wanted.sent


class ReplayedHid:
    """A `HidPort` that answers from a trace."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def write(self, report: bytes, timeout_s: float) -> None:
        """Check that this report was sent then."""
        self._replay.play(Call("write", sent=[report]))

    def read(self, timeout_s: float) -> bytes:
        """Return the report that came then."""
        return self._replay.play(Call("read")).got[0]

    def close(self) -> None:
        """Do nothing."""


class ReplayedBytes:
    """A `BytePort` that answers from a trace."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def write(self, data: bytes, timeout_s: float) -> None:
        """Check that these bytes were sent then."""
        self._replay.play(Call("write", sent=[data]))

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return the bytes that came then."""
        return self._replay.play(Call("read", args=[max_bytes])).got[0]

    def close(self) -> None:
        """Do nothing."""


class ReplayedSys:
    """A `SysPort` that answers from a trace."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay

    def open(self, path: str) -> int:
        """Return the descriptor of then."""
        return self._number(Call("open", args=[path]))

    def close(self, fd: int) -> None:
        """Check that it was closed then."""
        self._replay.play(Call("close", args=[fd]))

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Put the memory of then in place."""
        parts = [argument] if payload is None else [argument, payload]
        wanted = Call("ioctl", args=[fd, request], sent=[bytes(part) for part in parts])
        call = self._replay.play(wanted)
        for part, data in zip(parts, call.got, strict=True):
            part[:] = data
        return call.result if isinstance(call.result, int) else 0

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Return anonymous memory; its content comes through `copy_out`."""
        self._replay.play(Call("mmap", args=[fd, length, offset]))
        return MappedMemory(-1, length)

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Return the bytes of then."""
        return self._replay.play(Call("copy_out", args=[length])).got[0]

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Return what came then."""
        return self._number(Call("poll", args=[fd, events]))

    def clock_ns(self) -> int:
        """Return the kernel's time of then."""
        return self._number(Call("clock_ns"))

    def list_nodes(self, pattern: str) -> list[str]:
        """Return the nodes of then."""
        result = self._replay.play(Call("list_nodes", args=[pattern])).result
        return result if isinstance(result, list) else []

    def read_file(self, path: str) -> bytes:
        """Return the content of then."""
        return self._replay.play(Call("read_file", args=[path])).got[0]

    def write_file(self, path: str, data: bytes) -> None:
        """Check that this was written then."""
        self._replay.play(Call("write_file", args=[path], sent=[data]))

    def _number(self, wanted: Call) -> int:
        result = self._replay.play(wanted).result
        return result if isinstance(result, int) else 0
