"""Requests to a GRBL controller and its answers: `ok`, `error:n`, reports, alarms, banners, in any order.

After ALARM:1 and 2 GRBL 1.1 answers nothing, not even `?`, until a soft reset (gnea/grbl, protocol.c,
protocol_exec_rt_system); during a homing cycle it answers nothing either, and only a soft reset ends the cycle
(limits.c, limits_go_home). In Hold, Door and Sleep it reads no line (protocol.c, protocol_exec_rt_suspend).

Here: the exchange. Not here: what a stage does with it (`driver`).
"""

from contextlib import suppress

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    BadReplyError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    RefusedError,
)
from gs2ci_drivers.grbl.build import LOCK_MS
from gs2ci_drivers.grbl.packets import (
    ALARMS,
    ERRORS,
    LOCKING_ALARMS,
    SOFT_RESET,
    STATUS_REQUEST,
    Status,
    is_banner,
    is_strange,
    parse_code,
    parse_status,
)
from gs2ci_drivers.lines import MOST_READS, LineChannel
from gs2ci_drivers.ports import BytePort, with_one_retry

REPLY_TIMEOUT_S = 1.0
"""Enough for a line, since it waits only behind a full planner buffer, which single jogs never fill."""
STATUS_TIMEOUT_S = 0.5
BOOT_TIMEOUT_S = 2.5
"""An Arduino's boot loader takes up to 2 s."""
RESET_TIMEOUT_S = 0.75
"""From a soft reset to the greeting: half a second after an alarm (report.c, report_alarm_message), else milliseconds.
Before it, a controller that moved stands still for `$1` ms (stepper.c, st_go_idle)."""
BARRIER = b"@\n$G\n"
"""`@` makes what a killed program left of a line one that no parser takes, so that it is not executed; the answer to
`$G` is like no other, and comes when all lines before it have been executed."""
ASK_NAME = b"\nM115\n"
"""Firmware of printers names itself (Marlin, M115.cpp: "FIRMWARE_NAME:Marlin ..."; Smoothieware, RepRapFirmware)."""
LINE_S = 0.05
"""From the first byte of a line to its last."""


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
        self.alarm: int | None = None
        """The last alarm's number, until the stage is homed."""
        self.locked = False
        """Whether the controller answers nothing until it is reset, after one of `LOCKING_ALARMS`."""
        self.restarted = False
        """Whether a greeting came since the connection or the last homing: the position may be lost."""
        self.suspicion = ""
        """What came since then that may have been a restart: silence, or text that may have been a greeting."""
        self.lock_s = LOCK_MS / 1000
        """For how long the controller stands still when it is reset in motion."""

    def await_boot(self) -> Status:
        """Wait for a status report; a controller whose line was just opened may have to boot first.

        One that gives neither a report nor a greeting gets a soft reset: an earlier session may have left it locked, or
        in a homing cycle.

        Returns:
            The first report, which alone has the offset of work positions.

        Raises:
            NoAnswerError: No report and no greeting came.
            BadReplyError, DisconnectedError: No usable answer.
        """
        self._lines.drain("connect")
        try:
            status = self._one_status("connect")
        except NoAnswerError:
            try:
                self._await_restart(BOOT_TIMEOUT_S)
            except NoAnswerError as error:
                self._reset_once()
                self._incidents.append(f"{error}; it answered after a soft reset")
            status = self.status("connect")
        self.restarted, self.suspicion = False, ""  # a restart before connecting is seen in the state
        return status

    def other_firmware(self) -> str:
        """Return how firmware of another kind names itself, which gives no answer to what GRBL is asked; "" if none.

        Raises:
            DisconnectedError: The port is gone.
        """
        self._lines.send(ASK_NAME, "M115")
        deadline_s = self._clock.now_s() + REPLY_TIMEOUT_S
        with suppress(NoAnswerError, BadReplyError):
            while True:
                _, named, told = self._next(deadline_s, "M115").partition("FIRMWARE_NAME:")
                if named:
                    return told.split(" SOURCE_CODE_URL")[0].strip()
        return ""

    def reset(self) -> Status:
        """Reset the controller softly, and wait until it reports again; motion and homing end at once.

        A reset within half a second of a locking alarm has no effect (protocol.c clears it), hence the second one.

        Raises:
            NoAnswerError, BadReplyError, DisconnectedError: It does not restart.
        """
        self.drain("soft reset")
        with_one_retry(self._reset_once, self._incidents)
        # The alarm's own restart may have crossed the reset: a second greeting comes before.
        return self.status("soft reset")

    def status(self, asked: str = "?") -> Status:
        """Request a status report; a lost or damaged one is requested again once.

        Args:
            asked: What it is requested for, for the message of an alarm.

        Raises:
            MoveFailedError: The controller is locked by an alarm and reports nothing.
            NoAnswerError, BadReplyError, DisconnectedError: No usable answer.
        """
        said = len(self._incidents)
        status = with_one_retry(lambda: self._one_status(asked), self._incidents)
        if len(self._incidents) > said:
            self.suspicion = self.suspicion or "silence"
        return status

    def synchronise(self) -> None:
        """Wait until all lines that were sent before, by whomever, have been executed or refused.

        Raises:
            NoAnswerError, BadReplyError, DisconnectedError: No usable answer: no line is read, or it is busy.
            MoveFailedError: The controller is locked by an alarm.
        """
        if self.locked:
            raise self.alarm_error("synchronise")
        self._lines.send(BARRIER, "$G")
        deadline_s = self._clock.now_s() + REPLY_TIMEOUT_S
        while not self._next(deadline_s, "$G").startswith("[GC:"):
            if self.locked:
                raise self.alarm_error("synchronise")
        while self._next(deadline_s, "$G") != "ok":
            continue

    def command(self, line: str, timeout_s: float = REPLY_TIMEOUT_S) -> list[str]:
        """Send a line and wait for its `ok`; return the lines before it.

        Raises:
            RefusedError: `error:n`.
            MoveFailedError: An alarm came instead, or has locked the controller.
            ReferenceLostError: The controller restarted.
            LinkError: No usable answer.
        """
        self.drain(line)
        if self.locked:
            raise self.alarm_error(line)
        self._lines.send(line.encode("ascii") + b"\n", line)
        deadline_s = self._clock.now_s() + timeout_s
        before: list[str] = []
        while True:
            text = self._next(deadline_s, line)
            if text == "ok":
                return before
            code = parse_code(text)
            if code and code[0] == "error":
                number = f"error:{code[1]}" if code[1] else text
                raise RefusedError(
                    self._name, line, number, ERRORS.get(code[1], "unknown error"), remedy=_remedy(code[1])
                )
            if code:
                raise self.alarm_error(line)
            if is_banner(text):
                raise ReferenceLostError(
                    self._name, line, ["the controller restarted"], remedy=f"home the stage: `{HOME_COMMAND}`"
                )
            before.append(text)

    def send(self, data: bytes, asked: str) -> None:
        """Send real-time bytes, which are not answered."""
        self._lines.send(data, asked)

    def drain(self, asked: str) -> None:
        """Discard the lines that wait, once the alarms and restarts that they report are noted.

        Raises:
            DisconnectedError: The port is gone.
        """
        with suppress(NoAnswerError, BadReplyError):
            for _ in range(MOST_READS):
                patience_s = LINE_S if self._lines.begun(asked) else 0.0
                self._next(self._clock.now_s() + patience_s, asked)
        self._lines.drain(asked)

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
            remedy=f"remove the obstacle, then home the stage: `{HOME_COMMAND}`",
        )

    def _reset_once(self) -> None:
        self._lines.send(SOFT_RESET, "soft reset")
        self._await_restart(RESET_TIMEOUT_S + self.lock_s)

    def outlast_silence(self) -> None:
        """Wait for a controller that has just not answered: it may be booting; a report of it proves no restart.

        Raises:
            NoAnswerError: It does not come back in the time that a boot takes.
        """
        deadline_s = self._clock.now_s() + BOOT_TIMEOUT_S
        self.suspicion = self.suspicion or "silence"
        while not self.restarted:
            try:
                self._one_status("connect")
            except NoAnswerError:
                if self._clock.now_s() >= deadline_s:
                    raise
            else:
                return

    def _await_restart(self, timeout_s: float) -> None:
        """Wait for a greeting, or for text that may be one; a controller that reports has restarted, too."""
        deadline_s = self._clock.now_s() + timeout_s
        while True:
            try:
                text = self._next(deadline_s, "greeting")
            except NoAnswerError as silent:
                try:
                    self._one_status("greeting", although_locked=True)
                except NoAnswerError:
                    raise silent from None
                self.restarted, self.locked = True, False
                return
            if is_banner(text) or is_strange(text):
                self.restarted, self.locked = True, False
                return

    def _one_status(self, asked: str, *, although_locked: bool = False) -> Status:
        self.drain(asked)  # the report that answers now, and none of before
        self._lines.send(STATUS_REQUEST, "?")
        deadline_s = self._clock.now_s() + STATUS_TIMEOUT_S
        while True:
            if self.locked and not although_locked:
                raise self.alarm_error(asked)
            text = self._next(deadline_s, "?")
            if text.startswith("<"):
                try:
                    status = parse_status(text)
                except ValueError as error:
                    raise BadReplyError(
                        self._name, "?", text.encode(), str(error), allowed="<State|MPos:x,y,z|...>"
                    ) from error
                if status.state == "Alarm":  # grblHAL can tell its number here ($10, bit 10)
                    self.alarm = status.substate or self.alarm
                return status

    def _next(self, deadline_s: float, asked: str) -> str:
        """Return the next line; store an alarm or a restart that it reports."""
        text = self._lines.line(deadline_s, asked).decode("ascii", "replace")
        code = parse_code(text)
        if code and code[0] == "ALARM":
            self.alarm = code[1]
            self.locked = code[1] in LOCKING_ALARMS
        if is_banner(text):
            self.restarted, self.locked = True, False
        elif is_strange(text):
            self.suspicion = repr(text)
        return text


def _remedy(error: int) -> str:
    if error == 9:
        return f"home the stage: `{HOME_COMMAND}`"
    if error == 15:
        return "keep the target, with the sweep's run-up, inside the machine's travel ($130-$132)"
    if error in (18, 40, 45, 50, 51, 79):
        return "release the stop, switch or pin that it names, reset the controller, then home the stage"
    if error == 8:
        return "wait until nothing moves, or stop it; see the controller's state"
    return "see the controller's settings with $$"
