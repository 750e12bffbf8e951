"""One request and its answer over an APT line, between messages that nobody asked for.

Controllers send end-of-move messages on their own, and status updates ten times a second if another program has asked
for them (MGMSG_HW_START_UPDATEMSGS) and left. Positions and states are therefore asked for by messages whose answers
are never sent unasked (POSCOUNTER, STATUSBITS), so that an old update cannot be taken for an answer.

Here: the exchange. Not here: what a stage does with it (`driver`).
"""

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, NoAnswerError
from gs2ci_drivers.kinesis.packets import CHANNEL, AptMessage, Message, find_message, short
from gs2ci_drivers.ports import BytePort, port_errors, with_one_retry

REPLY_TIMEOUT_S = 0.5
"""Controllers answer within some milliseconds; the rest is for USB serial adapters and busy hosts."""
WRITE_TIMEOUT_S = 1.0
CHUNK_BYTES = 256
MOST_NOISE_BYTES = 512
MOST_READS = 64


class AptLink:
    """The exchange with one line.

    Args:
        name: Name of the stage, for messages.
        port: The serial line.
        clock: The clock of the deadlines.
        sources: Addresses of the units that are spoken to.
        incidents: Receives the problems from which the link recovered.
    """

    def __init__(
        self, name: str, port: BytePort, clock: Clock, *, sources: frozenset[int], incidents: list[str]
    ) -> None:
        self._name = name
        self._port = port
        self._clock = clock
        self._sources = sources
        self._incidents = incidents
        self._buffer = b""

    def send(self, data: bytes, asked: str) -> None:
        """Send a message that is not answered.

        Raises:
            NoAnswerError: Not taken in time.
            DisconnectedError, AccessError: The port is gone.
        """
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            self._port.write(data, WRITE_TIMEOUT_S)

    def ask(self, request: Message, unit: int, length: int, channel: int = CHANNEL) -> AptMessage:
        """Send a request that changes nothing, and wait for its answer; once more if that is lost.

        Args:
            request: The request; the id of its answer is the next one.
            unit: Address of the unit that is asked.
            length: Bytes of data of the answer, at least.
            channel: The channel that is asked for.

        Raises:
            NoAnswerError, BadReplyError: No usable answer, twice.
            DisconnectedError: The port is gone.
        """
        asked = f"MGMSG_{request.name}"
        return with_one_retry(lambda: self.ask_once(request, unit, length, asked, channel), self._incidents)

    def ask_once(self, request: Message, unit: int, length: int, asked: str, channel: int = CHANNEL) -> AptMessage:
        """As `ask`, but not again if the answer is lost: what was sent before may be lost, too."""
        self.drain(asked)
        self.send(short(request, unit, channel), asked)
        deadline_s, passed = self._clock.now_s() + REPLY_TIMEOUT_S, 0
        for _ in range(CHUNK_BYTES * MOST_READS):
            message, self._buffer, noise = find_message(self._buffer, self._sources)
            passed += noise
            if passed > MOST_NOISE_BYTES:
                raise BadReplyError(self._name, asked, self._buffer, f"{passed} bytes that are no message")
            if message is None:
                if not self._receive(deadline_s, asked):
                    break
            elif (message.ident, message.source) == (request + 1, unit):
                if len(message.data) < length:
                    raise BadReplyError(
                        self._name, asked, message.data, "too few bytes", allowed=f"{length} bytes of data"
                    )
                return message
            else:
                self._note(message)
        raise NoAnswerError(self._name, asked, REPLY_TIMEOUT_S)

    def drain(self, asked: str) -> None:
        """Discard what has come unasked."""
        self._buffer = b""
        with port_errors(self._name, asked):
            for _ in range(MOST_READS):
                self._buffer += self._port.read(CHUNK_BYTES, 0.0)
                message, self._buffer, _ = find_message(self._buffer, self._sources)
                if message is None:
                    break
                self._note(message)
        self._buffer = b""

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _receive(self, deadline_s: float, asked: str) -> bool:
        """Wait for more bytes; return whether any came."""
        left_s = deadline_s - self._clock.now_s()
        if left_s <= 0:
            return False
        with port_errors(self._name, asked):
            data = self._port.read(CHUNK_BYTES, left_s)
        self._buffer += data
        return bool(data)

    def _note(self, message: AptMessage) -> None:
        """Keep what a controller says of its own accord about an error."""
        if message.ident == Message.HW_RICHRESPONSE and len(message.data) >= 68:
            words = message.data[4:68].split(b"\0")[0].decode("ascii", "replace")
            code = int.from_bytes(message.data[2:4], "little")
            self._incidents.append(f"{self._name}: the controller reports error {code}: {words}")
        elif message.ident == Message.HW_RESPONSE:
            self._incidents.append(f"{self._name}: the controller reports an error without a text")
