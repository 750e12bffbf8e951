"""Requests to a GRBL controller and its answers: `ok`, `error:n`, reports, alarms, banners, in any order.

Here: the exchange. Not here: what a stage does with it (`driver`).
"""

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, MoveFailedError, NoAnswerError, ReferenceLostError, RefusedError
from gs2ci_drivers.grbl.packets import (
    ALARMS,
    ERRORS,
    STATUS_REQUEST,
    Status,
    is_banner,
    parse_code,
    parse_status,
)
from gs2ci_drivers.lines import LineChannel
from gs2ci_drivers.ports import BytePort, with_one_retry

REPLY_TIMEOUT_S = 1.0
"""Enough for a line, since it waits only behind a full planner buffer, which single jogs never fill."""
STATUS_TIMEOUT_S = 0.5
BOOT_TIMEOUT_S = 2.5
"""An Arduino's boot loader takes up to 2 s."""


class GrblLink:
    """The exchange with one controller.

    Args:
        name: Name of the stage, for messages.
        port: The serial line.
        clock: The clock of the deadlines.
        incidents: Receives the problems from which the link recovered.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, incidents: list[str]) -> None:
        self._name = name
        self._clock = clock
        self._incidents = incidents
        self._lines = LineChannel(name, port, clock)
        self._text = ""
        self.alarm: int | None = None
        """The last alarm's number, until the controller is reset or homed."""
        self.restarted = False
        """Whether a banner came without a reset by this link: the controller restarted and lost its position."""

    def await_boot(self) -> None:
        """Wait for a status report; a controller whose line was just opened may have to boot first."""
        self._lines.drain("connect")
        try:
            self._one_status()
        except NoAnswerError:
            self.await_banner()
        self.restarted = False  # a restart before connecting is seen in the state

    def await_banner(self) -> None:
        """Wait for the banner after a reset.

        Raises:
            NoAnswerError: None came.
        """
        deadline_s = self._clock.now_s() + BOOT_TIMEOUT_S
        while not is_banner(self._next(deadline_s, "banner")):
            continue
        self.alarm, self.restarted = None, False

    def status(self) -> Status:
        """Request a status report; a lost or damaged one is requested again once.

        Raises:
            NoAnswerError, BadReplyError, DisconnectedError: No usable answer.
        """
        return with_one_retry(self._one_status, self._incidents)

    def command(self, line: str, timeout_s: float = REPLY_TIMEOUT_S) -> list[str]:
        """Send a line and wait for its `ok`; return the lines before it.

        Raises:
            RefusedError: `error:n`.
            MoveFailedError: An alarm came instead.
            ReferenceLostError: The controller restarted.
            LinkError: No usable answer.
        """
        self._lines.drain(line)
        self._lines.send(line.encode("ascii") + b"\n", line)
        deadline_s = self._clock.now_s() + timeout_s
        before: list[str] = []
        while True:
            text = self._next(deadline_s, line)
            if text == "ok":
                return before
            code = parse_code(text)
            if code and code[0] == "error":
                raise RefusedError(
                    self._name, line, text, ERRORS.get(code[1], "unknown error"), remedy=_remedy(code[1])
                )
            if code:
                raise self.alarm_error(line)
            if self.restarted:
                raise ReferenceLostError(
                    self._name, line, ["the controller restarted"], remedy="home the stage: `gs2ci devices --home`"
                )
            before.append(text)

    def send(self, data: bytes, asked: str) -> None:
        """Send real-time bytes, which are not answered."""
        self._lines.send(data, asked)

    def drain(self) -> None:
        """Discard the bytes that wait on the line."""
        self._lines.drain()

    def close(self) -> None:
        """Close the port."""
        self._lines.close()

    def alarm_error(self, asked: str) -> MoveFailedError:
        """Return the error for the present alarm."""
        number = self.alarm
        meaning = "unknown alarm" if number is None else ALARMS.get(number, "unknown alarm")
        return MoveFailedError(
            self._name,
            asked,
            [f"ALARM:{'?' if number is None else number} ({meaning})"],
            remedy="remove the obstacle, then home the stage: `gs2ci devices --home`",
        )

    def _one_status(self) -> Status:
        self._lines.send(STATUS_REQUEST, "?")
        deadline_s = self._clock.now_s() + STATUS_TIMEOUT_S
        while True:
            text = self._next(deadline_s, "?")
            if text.startswith("<"):
                try:
                    return parse_status(text)
                except ValueError as error:
                    raise BadReplyError(
                        self._name, "?", text.encode(), str(error), allowed="<State|MPos:x,y,z|...>"
                    ) from error

    def _next(self, deadline_s: float, asked: str) -> str:
        """Return the next line; store an alarm or a restart that it reports."""
        text = self._lines.line(deadline_s, asked).decode("ascii", "replace")
        code = parse_code(text)
        if code and code[0] == "ALARM":
            self.alarm = code[1]
        if is_banner(text):
            self.restarted = True
        return text


def _remedy(error: int) -> str:
    if error == 9:
        return "home the stage: `gs2ci devices --home`"
    if error == 15:
        return "keep the target, with the sweep's run-up, inside the machine's travel ($130-$132)"
    return "see the controller's settings with $$"
