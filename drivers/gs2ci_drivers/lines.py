"""Lines over a stream of bytes: what the serial drivers (Zaber, GRBL, SCPI) share.

Here: sending a line, waiting for one with a deadline, discarding what is left of an earlier exchange. Not here: what
the lines mean.
"""

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, NoAnswerError
from gs2ci_drivers.ports import BytePort, port_errors

LONGEST_LINE = 512
"""Bytes after which a line without an end is noise; every protocol here stays below 130."""
CHUNK_BYTES = 256
WRITE_TIMEOUT_S = 1.0
MOST_READS = 64
"""Limit on reads of bytes that are already there, when draining or past a deadline: a device that never stops sending
must not block the host."""
NOISE = b"\x00\xff"
"""Bytes that a floating or resetting line gives; no protocol here uses them."""


class LineChannel:
    """A port read and written by lines.

    Args:
        device: Name of the device, for messages.
        port: The port.
        clock: Where deadlines are kept.
    """

    def __init__(self, device: str, port: BytePort, clock: Clock) -> None:
        self._device = device
        self._port = port
        self._clock = clock
        self._buffer = b""
        self._late_reads = 0

    def send(self, data: bytes, asked: str) -> None:
        """Send bytes as they are.

        Raises:
            NoAnswerError: Not taken in time.
            DisconnectedError, AccessError: The port is gone.
        """
        self._late_reads = 0
        with port_errors(self._device, asked, timeout_s=WRITE_TIMEOUT_S):
            self._port.write(data, WRITE_TIMEOUT_S)

    def line(self, deadline_s: float, asked: str) -> bytes:
        """Wait for the next line that is not empty; return it without its end and without noise at its edges.

        Args:
            deadline_s: Latest time on the clock.
            asked: What it answers, for messages.

        Raises:
            NoAnswerError: None came in time.
            BadReplyError: More bytes than any line has, without an end.
            DisconnectedError: The port is gone.
        """
        begin_s = self._clock.now_s()
        while True:
            line = self._take()
            if line:
                return line
            left_s = deadline_s - self._clock.now_s()
            self._late_reads += left_s <= 0
            with port_errors(self._device, asked):
                data = self._port.read(CHUNK_BYTES, max(left_s, 0.0))
            if self._clock.now_s() >= deadline_s and (not data or self._late_reads > MOST_READS):
                raise NoAnswerError(self._device, asked, max(self._clock.now_s() - begin_s, 0.0))
            self._buffer += data
            if len(self._buffer) > LONGEST_LINE and b"\n" not in self._buffer:
                noise, self._buffer = self._buffer, b""
                raise BadReplyError(self._device, asked, noise, "no end of line", allowed="lines of text")

    def begun(self, asked: str) -> bool:
        """Return whether at least the beginning of a line is there; never waits.

        Raises:
            DisconnectedError: The port is gone.
        """
        with port_errors(self._device, asked):
            self._buffer += self._port.read(CHUNK_BYTES, 0.0)
        return bool(self._buffer.strip(NOISE + b"\r\n "))

    def drain(self, asked: str = "drain") -> int:
        """Discard all bytes received so far; return how many.

        Raises:
            DisconnectedError: The port is gone.
        """
        dropped, self._buffer = len(self._buffer), b""
        for _ in range(MOST_READS):
            with port_errors(self._device, asked):
                data = self._port.read(CHUNK_BYTES, 0.0)
            if not data:
                break
            dropped += len(data)
        return dropped

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _take(self) -> bytes:
        """Cut the first non-empty line off the buffer, b"" when there is none yet."""
        while b"\n" in self._buffer:
            line, self._buffer = self._buffer.split(b"\n", 1)
            line = line.strip(NOISE + b"\r\n ")
            if line:
                return line
        return b""
