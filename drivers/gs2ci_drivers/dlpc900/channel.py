"""One request, one answer: the exchange with a DLPC900 over a HID port, with deadlines and typed errors.

Here: numbering, draining, discarding answers to other requests, reading the reason after a refusal. Not here: which
requests are sent in which order (`driver`), the bytes themselves (`packets`).

The device has one 512-byte buffer for both directions: an answer that is not fetched is overwritten by the next
request. So a request is sent only after all old answers were read, and an answer with another sequence number is
discarded while waiting goes on (it is late, or left over from a session that was killed).
"""

from collections.abc import Callable, Sequence
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.dlpc900.packets import (
    NEVER_ACKNOWLEDGED,
    Command,
    HidReply,
    MalformedHidReplyError,
    describe_error,
    parse_reply,
    read_request,
    reply_reports,
    split_reports,
    write_request,
)
from gs2ci_drivers.dlpc900.payloads import decode_text
from gs2ci_drivers.failures import BadReplyError, NoAnswerError, RefusedError
from gs2ci_drivers.ports import HID_REPORT_BYTES, HidPort, port_errors, with_one_retry

# A device that keeps sending without a request is broken; one reply has at most eight reports.
_MAX_STALE_REPORTS: Final = 64
# How long the device may take to accept one report.
_WRITE_TIMEOUT_S: Final = 1.0


class Channel:
    """Numbered requests to one controller, and their answers.

    Args:
        device: Name of the device, for messages.
        port: The port for the reports.
        clock: The clock of the deadlines.
        incidents: Receives the problems from which the channel recovered.
        reply_timeout_s: How long an answer may take; TI's own library waits 10 s.
    """

    def __init__(
        self,
        device: str,
        port: HidPort,
        clock: Clock,
        *,
        incidents: list[str],
        reply_timeout_s: float,
    ) -> None:
        self.device = device
        self._port = port
        self._clock = clock
        self._incidents = incidents
        self._reply_timeout_s = reply_timeout_s
        self._sequence = 0
        self._unsent_reports = 0

    def read(self, command: Command, asked: str, *, length: int = 1) -> bytes:
        """Read a register of at least `length` bytes; a lost or damaged answer is requested again once.

        Only for registers that reading does not change: not for the error register.

        Raises:
            NoAnswerError: No answer to this request within the deadline.
            BadReplyError: Only unreadable answers came, or fewer bytes than the register has.
            RefusedError: The device refused.
            DisconnectedError: The device is gone.
        """
        reply = with_one_retry(
            lambda: self._exchange(read_request(command, self._next_sequence()), asked), self._incidents
        )
        if reply.refused:
            self._raise_refusal(asked)
        if len(reply.data) < length:
            raise BadReplyError(self.device, asked, reply.data, f"{len(reply.data)} bytes", allowed=f"{length} bytes")
        return reply.data

    def write(self, command: Command, data: bytes, asked: str) -> None:
        """Write a setting and wait until the device acknowledges it.

        Raises:
            NoAnswerError, BadReplyError, RefusedError, DisconnectedError: As `read`.
        """
        if self._exchange(write_request(command, data, self._next_sequence()), asked).refused:
            self._raise_refusal(asked)

    def stream(self, command: Command, payloads: Sequence[bytes], asked: str, on_sent: Callable[[int], None]) -> None:
        """Send many payloads of a command that is never acknowledged; `on_sent(n)` after each, n bytes in all.

        Raises:
            NoAnswerError: A report was not taken in time.
            DisconnectedError: The device is gone.
        """
        assert command in NEVER_ACKNOWLEDGED, command
        sent = 0
        with port_errors(self.device, asked, timeout_s=_WRITE_TIMEOUT_S):
            for payload in payloads:
                self._send(write_request(command, payload, self._next_sequence(), acknowledge=False))
                sent += len(payload)
                on_sent(sent)

    def take_error(self) -> tuple[int, str]:
        """Read the error register, which clears it: (code, the device's own words), code 0 when all is well.

        Raises:
            NoAnswerError, BadReplyError, DisconnectedError: As `read`.
        """
        asked = "read the error register"
        reply = self._exchange(read_request(Command.ERROR_CODE, self._next_sequence()), asked)
        if reply.refused:
            raise BadReplyError(self.device, asked, reply.data, "refused to report its error", allowed="1 byte")
        code = reply.data[0]
        if code == 0:
            return 0, ""
        text = self._exchange(read_request(Command.ERROR_TEXT, self._next_sequence()), asked)
        return code, "" if text.refused else decode_text(text.data)

    def check_error(self, asked: str) -> None:
        """Check that no command failed of those that are not acknowledged.

        Raises:
            RefusedError: The error register holds a code.
            NoAnswerError, BadReplyError, DisconnectedError: As `read`.
        """
        code, text = self.take_error()
        if code:
            self._raise_code(asked, code, text, remedy="upload again: the device received other data than were sent")

    def drain(self, asked: str) -> None:
        """Discard what an interrupted exchange left in the device, in both directions.

        Raises:
            BadReplyError: The device does not stop sending.
            NoAnswerError, DisconnectedError: As `stream`.
        """
        with port_errors(self.device, asked, timeout_s=_WRITE_TIMEOUT_S):
            while self._unsent_reports:
                # The device still waits for the rest of a message whose sending was interrupted: complete it.
                self._port.write(bytes(HID_REPORT_BYTES), _WRITE_TIMEOUT_S)
                self._unsent_reports -= 1
            for _ in range(_MAX_STALE_REPORTS):
                stale = self._port.read(0.0)
                if not stale:
                    return
        raise BadReplyError(self.device, asked, stale, "the device keeps sending without a request", allowed="silence")

    def _next_sequence(self) -> int:
        self._sequence = (self._sequence + 1) & 0xFF
        return self._sequence

    def _send(self, message: bytes) -> None:
        reports = split_reports(message)
        self._unsent_reports = len(reports)
        for report in reports:
            try:
                self._port.write(report, _WRITE_TIMEOUT_S)
            except OSError:
                if self._unsent_reports == len(reports):
                    self._unsent_reports = 0  # the device has seen none of it
                raise
            self._unsent_reports -= 1

    def _exchange(self, message: bytes, asked: str) -> HidReply:
        self.drain(asked)
        with port_errors(self.device, asked, timeout_s=_WRITE_TIMEOUT_S):
            self._send(message)
            return self._await_reply(message, asked)

    def _await_reply(self, request: bytes, asked: str) -> HidReply:
        """Wait for the answer that carries the request's number and direction."""
        deadline_s = self._clock.now_s() + self._reply_timeout_s
        garbage: tuple[bytes, str] | None = None
        while (left_s := deadline_s - self._clock.now_s()) > 0:
            first = self._port.read(left_s)
            if not first:
                break
            try:
                reply = parse_reply(self._collect(first, deadline_s))
            except MalformedHidReplyError as error:
                garbage = first, error.problem
                continue
            if reply.sequence == request[1] and reply.is_read == bool(request[0] & 0x80):
                return reply
        if garbage:
            raise BadReplyError(self.device, asked, garbage[0], garbage[1], allowed="a reply to this request")
        raise NoAnswerError(self.device, asked, self._reply_timeout_s)

    def _collect(self, first: bytes, deadline_s: float) -> bytes:
        """Read the continuation reports that the first one announces; fewer if they do not come in time."""
        reports = [first]
        for _ in range(reply_reports(first) - 1):
            more = self._port.read(max(deadline_s - self._clock.now_s(), 0.0))
            if not more:
                break
            reports.append(more)
        return b"".join(reports)

    def _raise_refusal(self, asked: str) -> None:
        code, text = self.take_error()
        self._raise_code(asked, code, text)

    def _raise_code(self, asked: str, code: int, text: str, remedy: str = "") -> None:
        known = describe_error(code)
        # Some refusals leave the register empty, and the device's text often repeats the manual's.
        meaning = known.meaning if code else "no reason given"
        if text and text.lower() != meaning:
            meaning += f": {text}"
        raise RefusedError(self.device, asked, code, meaning, remedy=remedy or known.remedy)
