"""The common part of all twins behind a serial line: bytes at a baud rate, and the faults of such a line.

A twin's firmware receives each complete line (`_line`) and each byte that bypasses lines (`_realtime`), and answers
with `_reply`. Faults of the line lose, delay, repeat, cut, join and corrupt messages, and unplug the port.

Here: the byte level. Not here: the protocols. `gs2ci.rig` and tests call `open`, `plug_in` and the fault set.
"""

from abc import abstractmethod
from errno import EIO

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.plugged import Plugged, Session
from gs2ci_sims.world import VirtualClock

REPLY_LATENCY_S = 1.5e-3
# So much of what is written tells which request it is; pictures follow theirs.
_TOLD_BYTES = 4096
PIECE_GAP_S = 2e-3


class SerialTwin(Plugged["SerialSession"]):
    """A device behind a serial line; unplugging does not cut its power.

    Args:
        clock: The world's clock.
        faults: The faults to inject.
        baud: Bits per second, 8N1.
    """

    def __init__(self, clock: VirtualClock, faults: FaultSet | None = None, baud: int = 115200) -> None:
        super().__init__(faults)
        self.clock = clock
        self._byte_s = 10.0 / baud
        self._incoming = b""
        self._outgoing = b""
        self._held = b""
        self._line_free_s = 0.0

    def _begin_session(self) -> "SerialSession":
        self._outgoing = self._stale() if self.faults.take("serial.stale") else b""
        return SerialSession(self)

    def _lose(self) -> None:
        self._incoming = self._outgoing = self._held = b""

    @property
    @abstractmethod
    def terminators(self) -> bytes:
        """Get the bytes that end a request."""

    @abstractmethod
    def _line(self, line: bytes) -> None:
        """Receive one request without its terminator."""

    @abstractmethod
    def _stale(self) -> bytes:
        """Return a valid reply to a request that this session has not sent."""

    def _closed(self) -> None:
        """React to the end of a session, in which the host releases the modem lines; most devices ignore it."""
        self._incoming = b""

    def _realtime(self, byte: int) -> bool:
        """Process a byte that bypasses lines; return whether it was one."""
        return False

    def _reply(self, data: bytes, about: str = "", delay_s: float = REPLY_LATENCY_S) -> None:
        """Send bytes to the host, with the faults of the line."""
        take = self.faults.take
        if take("serial.reply_lost", about):
            return
        late = take("serial.reply_late", about)
        if late:
            delay_s += late.value or 1.0
        if take("serial.reply_spoilt", about):
            middle = len(data) // 2
            data = data[:middle] + bytes([data[middle] ^ 0x01]) + data[middle + 1 :]
        if take("serial.reply_cut", about):
            data = data[: len(data) // 2]
        if take("serial.noise", about):
            data = b"\x00\xff\xff\x00" + data
        if take("serial.babble", about):
            data = bytes(128 + i % 96 for i in range(600)) + data
        if take("serial.reply_twice", about):
            data = data + data
        if take("serial.replies_joined", about):
            self._held += data
            return
        data, self._held = self._held + data, b""
        self._transmit(data, delay_s, in_pieces=take("serial.reply_in_pieces", about) is not None)

    def _transmit(self, data: bytes, delay_s: float, *, in_pieces: bool = False) -> None:
        """Put bytes on the line at its rate."""
        start_s = max(self.clock.now_s() + delay_s, self._line_free_s if delay_s <= REPLY_LATENCY_S else 0.0)
        if in_pieces:
            for i, byte in enumerate(data):
                self._arrive(bytes([byte]), start_s + (i + 1) * PIECE_GAP_S)
            return
        end_s = start_s + len(data) * self._byte_s
        self._line_free_s = end_s
        self._arrive(data, end_s)

    def _arrive(self, data: bytes, when_s: float) -> None:
        def deliver() -> None:
            if self.plugged:
                self._outgoing += data

        self.clock.at(when_s, deliver)

    def _receive(self, data: bytes) -> None:
        """Receive bytes from the host."""
        ends = self.terminators
        for i, byte in enumerate(data):
            if self._realtime(byte):
                continue
            if byte not in ends:
                self._incoming += data[i : i + 1]
                continue
            line, self._incoming = self._incoming, b""
            if not self.faults.take("serial.request_lost", line.decode("ascii", "replace")):
                self._line(line)


class SerialSession(Session[SerialTwin]):
    """One opening of a twin's port: a `BytePort`."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send bytes to the twin, which takes the time that follows from the baud rate.

        Raises:
            OSError: The device is unplugged.
            TimeoutError: The line is stuck.
        """
        twin = self._twin
        self._require_alive()
        about = data[:_TOLD_BYTES].decode("ascii", "replace")
        if twin.faults.take("serial.unplugged", about):
            twin.unplug()
            raise OSError(EIO, "Input/output error")
        if twin.faults.take("serial.write_stuck", about):
            twin.clock.sleep_s(timeout_s)
            raise TimeoutError("Write timeout")
        twin.clock.sleep_s(len(data) * twin._byte_s)
        twin._receive(data)

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Wait for bytes from the twin."""
        twin = self._twin
        self._require_alive()
        twin.clock.wait_until(lambda: bool(twin._outgoing) or not twin.plugged, timeout_s)
        self._require_alive()
        data, twin._outgoing = twin._outgoing[:max_bytes], twin._outgoing[max_bytes:]
        return data
