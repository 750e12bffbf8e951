"""One request and its reply: ids, checksums, alerts in between, late replies, deadlines.

Here: the exchange of messages with a Zaber chain. Not here: what a stage does with them (`driver`).
"""

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, NoAnswerError, RefusedError
from gs2ci_drivers.lines import LineChannel
from gs2ci_drivers.ports import BytePort, with_one_retry
from gs2ci_drivers.zaber.flags import REJECTIONS, describe, is_fault
from gs2ci_drivers.zaber.packets import MESSAGE_IDS, Alert, ZaberReply, parse, request

REPLY_TIMEOUT_S = 0.5
"""Devices answer within about 10 ms; the rest is for USB serial adapters and busy hosts."""


class ZaberLink:
    """The exchange with one device address.

    Args:
        name: Name of the stage, for messages.
        port: The serial line.
        clock: The clock of the deadlines.
        address: The device's address in the chain.
        with_checksum: Whether requests carry checksums; those in replies are always checked.
        incidents: Receives the problems from which the link recovered.
    """

    def __init__(
        self,
        name: str,
        port: BytePort,
        clock: Clock,
        *,
        address: int,
        with_checksum: bool,
        incidents: list[str],
    ) -> None:
        self._name = name
        self._clock = clock
        self._address = address
        self._with_checksum = with_checksum
        self._incidents = incidents
        self._lines = LineChannel(name, port, clock)
        # The session begins at an id that most probably differs from the last one's end, so old replies are recognised.
        self._next_id = int(clock.now_s() * 1e3) % MESSAGE_IDS

    def query(self, axis: int, text: str) -> ZaberReply:
        """Send a request that changes nothing; a lost or damaged answer is requested again once.

        Raises:
            LinkError: No usable answer.
            RefusedError: The device refused.
        """
        return with_one_retry(lambda: self.command(axis, text), self._incidents)

    def command(self, axis: int, text: str) -> ZaberReply:
        """Send a request once and return its reply.

        Raises:
            NoAnswerError: Nothing in time.
            BadReplyError: Only unreadable lines, or lines of other devices, came in time.
            RefusedError: The device refused.
            DisconnectedError: The port is gone.
        """
        message_id = self._next_id
        self._next_id = (message_id + 1) % MESSAGE_IDS
        asked = f"/{self._address:02d} {axis} {text}".rstrip()
        self._lines.drain(asked)
        self._lines.send(request(self._address, axis, message_id, text, with_checksum=self._with_checksum), asked)
        reply = self._reply(message_id, asked)
        if not reply.accepted:
            meaning = REJECTIONS.get(reply.data, "unknown rejection")
            raise RefusedError(self._name, asked, reply.data or "RJ", meaning)
        return reply

    def drain(self) -> None:
        """Discard the bytes that wait on the line."""
        self._lines.drain()

    def close(self) -> None:
        """Close the port."""
        self._lines.close()

    def _reply(self, message_id: int, asked: str) -> ZaberReply:
        deadline_s = self._clock.now_s() + REPLY_TIMEOUT_S
        spoilt: tuple[bytes, str] | None = None
        while True:
            try:
                line = self._lines.line(deadline_s, asked)
            except NoAnswerError as error:
                if spoilt:
                    raise BadReplyError(self._name, asked, *spoilt, allowed="@DD A ID OK|RJ ...") from error
                raise
            try:
                message = parse(line)
            except ValueError as error:
                spoilt = (line, str(error))
                continue
            if isinstance(message, Alert):
                self._note_alert(message)
            elif isinstance(message, ZaberReply):
                if (message.address, message.message_id) == (self._address, message_id):
                    return message
                spoilt = (line, f"from address {message.address} with id {message.message_id}")

    def _note_alert(self, alert: Alert) -> None:
        if is_fault(alert.warning):
            self._incidents.append(f"{self._name}: alert {describe(alert.warning)} on axis {alert.axis}")
