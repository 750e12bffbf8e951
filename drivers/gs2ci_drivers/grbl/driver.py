"""A stage on a GRBL 1.1 controller, also on grblHAL and FluidNC.

Every motion is a jog (`$J=`): it does not change the parser's modes, is refused as a whole if its target lies outside
the travel, and can be cancelled without losing the position. The end of a motion is checked twice (grbl issue 1115:
Idle can be reported early): first the state is Idle, then a `G4` dwell, which the planner executes last, is
acknowledged.

A jog cancel is dropped if it comes before the jog has begun, and Idle is reported meanwhile (serial.c, jog.c). So a
stop ends only when an exchange that comes behind all lines has shown that none is left, and the state is still Idle.
Another program's motion obeys only a feed hold; a hold is ended by a soft reset, which drops what waits behind it and
keeps the position at rest.

A soft reset loses the position if the machine moves. It is sent only where nothing else works: to a controller that is
locked or in a homing cycle, to one that gives no reports, in `stop` and, after the time to boot, in `connect`, and in
`stop` to one that is on hold or does not obey.

A restart shows by its greeting, whose text is the user's on some firmware; else by the position at rest, which does
not change by itself: `Rest` keeps it.

Here: what a stage does. Not here: lines (`link`), formats (`packets`), firmware and its settings (`build`, `setup`).
"""

from collections.abc import Mapping
from math import hypot

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    BadReplyError,
    DeviceFaultError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    RefusedError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.grbl.build import LETTERS, Build, SteppedAxis
from gs2ci_drivers.grbl.link import GrblLink
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.grbl.packets import (
    ALARMS,
    ALARMS_OF_BEFORE,
    FEED_HOLD,
    JOG_CANCEL,
    Status,
    jog,
)
from gs2ci_drivers.grbl.rest import Rest
from gs2ci_drivers.grbl.setup import ask_build, axis_info
from gs2ci_drivers.ports import BytePort
from gs2ci_drivers.stage import Stage, StageInfo, StageStatus

POLL_S = 0.2
"""The manual asks for at most 5 reports a second while moving."""
SAMPLE_GAP_S = 0.02
"""During a sweep it is asked more often: a report takes about 1 ms of the processor, which has computed its steps for
60 ms ahead (stepper.c, SEGMENT_BUFFER_SIZE)."""
STOP_TIMEOUT_S = 5.0
SYNC_TIMEOUT_S = 5.0
ARRIVAL_STEPS = 1.0
LOCKED_OUT, BEYOND, NOT_ALONE = "error:9", "error:15", "error:19"
OFFSET_REPORTS = 31
"""The offset of work positions comes at the latest with so many reports (config.h, REPORT_WCO_REFRESH_BUSY_COUNT)."""
OWN_AXES = (
    "homing drives z first and then x and y together, which a stage without these switches cannot end: build GRBL with "
    "HOMING_CYCLE_0 for its own axes only, or with HOMING_SINGLE_AXIS_COMMANDS"
)
SEEK, TRAVEL, SEARCH = 25, 130, 1.5
"""Homing looks for a switch over so many times the travel at $25, 500 mm/min as delivered (limits.c,
HOMING_AXIS_SEARCH_SCALAR)."""
LOCATE_S = 60.0
"""For what follows at $24."""
RESET_AT_CONTROLLER = "press reset at the controller, or switch it off and on; then home the stage"


class GrblStage(Stage):
    """Up to three axes on one controller, in machine coordinates.

    Args:
        name: Name in the rig file.
        port: The serial line.
        clock: The clock of all waits.
        options: From the rig file.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, options: GrblOptions | None = None) -> None:
        super().__init__(name, clock)
        self._names: tuple[str, ...] = (options or GrblOptions()).axes
        self._link = GrblLink(name, port, clock, self.incidents)
        self._build = Build()
        self._rest = Rest(name)
        self._targets: dict[str, float] = {}
        self._homing = self._homed = False

    @property
    def sample_gap_s(self) -> float:
        """Get the least time between two positions that are read while it moves."""
        return SAMPLE_GAP_S

    def _do_connect(self) -> StageInfo:
        try:
            status = self._come_to_rest(self._link.await_boot())
            self._build = ask_build(self._link, self.name, self._names)
        except (NoAnswerError, RefusedError) as error:
            if other := self._link.other_firmware():
                raise UnsupportedError(
                    self.name,
                    f"the board runs {other}",
                    asked="connect",
                    allowed="GRBL 1.1, grblHAL, FluidNC",
                    remedy="install one of these on the board: printers' firmware does not tell where an axis is while "
                    "it moves",
                ) from error
            raise
        self._link.lock_s = self._build.lock_s
        for _ in range(OFFSET_REPORTS):
            if status.machine is not None or self._rest.offset is not None or status.offset is not None:
                break
            status = self._link.status("connect")
        self._rest.settle(self._machine_mm(status))
        return StageInfo(
            model="GRBL controller" if self._build.family == "grbl" else f"{self._build.family} controller",
            serial="",
            firmware=self._build.version,
            axes={axis: axis_info(self._build, self.name, axis) for axis in self._names},
        )

    def _come_to_rest(self, status: Status) -> Status:
        """Bring a controller to where it answers questions, whatever an earlier session has left it doing.

        Raises:
            DeviceFaultError: It is in a state in which it takes no commands.
            LinkError: No usable answer.
        """
        while True:
            self._rest.offset = status.offset or self._rest.offset
            if (status.suspended and not status.moving) or status.state == "Check":
                what = f"state {status.state}, in which it takes no commands"
                raise DeviceFaultError(self.name, "connect", [what], remedy=RESET_AT_CONTROLLER)
            if status.moving:  # `$$` and `$I` are refused meanwhile
                self._do_stop()
                self.incidents.append(f"{self.name}: it moved when it was connected, and was stopped")
                return self._link.status("connect")
            try:
                self._link.synchronise()
            except NoAnswerError as error:  # a homing cycle that has just begun, for a session that was killed
                status = self._link.reset()
                self._link.restarted = False  # its state says so
                self.incidents.append(f"{error}; it answered after a soft reset")
                return status
            status = self._link.status("connect")
            if not status.moving:
                return status

    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        build = self._build
        if not build.homing_enabled:
            raise UnsupportedError(
                self.name,
                "homing is disabled ($22=0)",
                asked="home",
                remedy="enable it with $22=1 if the stage has reference switches",
            )
        self._link.drain("home")
        if self._link.alarm is not None:
            self._link.reset()  # ends a lock; after other alarms the controller restarts and would lose the next line
        self._targets = {}
        self._rest.leave()
        self._homing = True
        single = build.homes_single and len(self._names) < len(LETTERS)
        try:
            self._send_homes([f"$H{axis.upper()}" for axis in axes] if single else ["$H"], timeout_s)
        except RefusedError:
            self._homing = False  # it has not begun: `stop` need not reset
            raise
        except MoveFailedError as error:
            if not single and len(self._names) < len(LETTERS):
                error.remedy += f"; {OWN_AXES}"
            raise
        self._homing = self._link.restarted = False
        self._homed, self._link.alarm, self._link.suspicion = True, None, ""
        self._rest.settle(self._machine_mm(self._link.status("home")))

    def _do_home_time_s(self, axes: tuple[str, ...]) -> float:
        settings = self._build.settings
        if SEEK not in settings:  # FluidNC
            return 0.0
        travel_mm = sum(settings.get(TRAVEL + i, 0.0) for i in range(len(LETTERS)))
        return LOCATE_S + SEARCH * travel_mm / max(settings[SEEK] / 60.0, 1e-3)

    def _send_homes(self, commands: list[str], timeout_s: float) -> None:
        """Home axis by axis, or all together where FluidNC's configuration (allow_single_axis) forbids that."""
        try:
            for command in commands:
                self._send_home(command, timeout_s)
        except RefusedError as error:
            if error.code != NOT_ALONE:
                raise
            self._send_home("$H", timeout_s)

    def _send_home(self, command: str, timeout_s: float) -> None:
        """Home; once more if only an alarm of before came in answer, which nobody had heard."""
        try:
            self._link.command(command, timeout_s)
        except MoveFailedError:
            if self._link.alarm not in ALARMS_OF_BEFORE:
                raise
            self._link.reset()
            self._link.command(command, timeout_s)

    def _do_begin_move(self, targets_mm: Mapping[str, float], speed_mm_s: float) -> None:
        status = self._report("move")
        if status.state != "Idle":
            raise WrongStateError(
                self.name,
                f"state {status.state}",
                asked=f"move to {dict(targets_mm)}",
                remedy="close the safety door or release the hold at the controller; a stop ends a hold and drops what "
                "waits behind it",
            )
        here = self._positions(status)
        shares = [targets_mm[axis] - here[axis] for axis in targets_mm]
        longest = max(abs(share) for share in shares)
        path_mm_s = speed_mm_s * hypot(*shares) / longest if longest else speed_mm_s
        axis = self.info.axes[next(iter(targets_mm))]
        if len(targets_mm) == 1 and isinstance(axis, SteppedAxis):
            path_mm_s = axis.asked_mm_s(speed_mm_s)
        self._targets = dict(targets_mm)
        self._rest.leave()
        line = jog(targets_mm, path_mm_s * 60.0)
        try:
            self._link.command(line)
        except RefusedError as error:
            self._rest.settle(self._machine_mm(status))
            if error.code == BEYOND:
                error.remedy = self._who_is_outside(status) or error.remedy
            raise
        except NoAnswerError as error:
            status = self._link.status("move")
            if status.suspended:  # since the report before: the line waits in its buffer
                self._do_stop()
                raise MoveFailedError(
                    self.name,
                    line,
                    [f"state {status.state}: the move was neither read nor answered, and is taken back"],
                    remedy="close the safety door or release the hold at the controller, and repeat",
                ) from error
            raise

    def _who_is_outside(self, status: Status) -> str:
        """Return which axes stand outside their travel: soft limits check all of them, whichever is to move."""
        found = []
        for axis, position_mm in zip(LETTERS, self._machine_mm(status), strict=False):
            low_mm, high_mm = self._build.travel_mm(axis)
            if not low_mm <= position_mm <= high_mm:
                found.append(f"axis {axis} stands at {position_mm:.3f} mm, outside {low_mm:g} to {high_mm:g} mm")
        return f"{'; '.join(found)}: soft limits check every axis; home the stage: `{HOME_COMMAND}`" if found else ""

    def _do_wait_idle(self, timeout_s: float) -> None:
        asked = f"move to {self._targets} mm" if self._targets else "wait"
        status = self._wait_until_synchronised(timeout_s, asked)
        targets, self._targets = self._targets, {}
        here = self._positions(status)
        self._settle(status, targets)
        for axis, target in targets.items():
            info = self.info.axes[axis]
            if abs(here[axis] - target) <= ARRIVAL_STEPS * info.step_mm + info.report_mm:
                continue
            if self._link.restarted or self._link.suspicion:
                raise self._restarted(asked, f"axis {axis} counts {here[axis]:.4f} mm")
            raise MoveFailedError(
                self.name,
                asked,
                [f"axis {axis} at rest at {here[axis]:.4f} mm, short of its target"],
                remedy="the motion was cancelled: look for an obstacle or a pressed button",
            )
        self._link.suspicion = ""

    def _do_positions_mm(self) -> dict[str, float]:
        status = self._report("position")
        if self._targets and self._link.restarted:
            raise self._restarted(f"move to {self._targets} mm", f"state {status.state}")
        return self._positions(status)

    def _do_stop(self) -> None:
        self._link.drain("stop")
        status = None if self._homing or self._link.locked else self._halt()
        if status is None:
            status = self._link.reset()
            if status.moving:
                raise NoAnswerError(self.name, "stop", STOP_TIMEOUT_S, remedy="cut the stage's power")
        elif status.suspended:
            status = self._drop_what_waits(status)
        self._homing = False
        if self._rest.left:
            self._settle(status, self._targets)
        self._targets = {}  # not before: a stop may be interrupted

    def _halt(self) -> Status | None:
        """Cancel a jog, hold anything else; return the report of a controller at rest with nothing left to do.

        Returns:
            None for a controller that does not report, does not obey, or executes a line that does not end.
        """
        begin_s = self.clock.now_s()
        while True:
            self._link.send(JOG_CANCEL, "stop")
            try:
                status = self._link.status("stop")
                if status.suspended and not status.moving:
                    return status
                if not status.moving:
                    self._link.synchronise()
                    status = self._link.status("stop")
                    if not status.moving and not status.suspended:
                        return status
                    continue
            except (NoAnswerError, MoveFailedError):
                return None
            if status.state == "Run":
                self._link.send(FEED_HOLD, "stop")
            if self.clock.now_s() - begin_s > STOP_TIMEOUT_S:
                return None
            self.clock.sleep_s(POLL_S)

    def _drop_what_waits(self, held: Status) -> Status:
        """Reset a controller on hold: the line that waits would be executed when somebody resumes."""
        restarted, before_mm = self._link.restarted, self._machine_mm(held)
        status = self._link.reset()
        if status.state != "Alarm" and self._rest.same(before_mm, self._machine_mm(status)):
            self._link.restarted = restarted  # a reset at rest keeps the position
        self.incidents.append(f"{self.name}: state {held.state}: what waited behind it was dropped by a soft reset")
        return status

    def _do_status(self) -> StageStatus:
        try:
            status = self._report("status")
        except MoveFailedError as error:  # locked: it reports no position, and nothing moves
            return StageStatus(moving=False, referenced=False, faults=error.faults)
        faults, warnings = [], self._build.warnings(self._names)
        if status.state == "Alarm" and self._link.alarm is not None:
            faults.append(f"ALARM:{self._link.alarm} ({ALARMS.get(self._link.alarm, 'unknown alarm')})")
        if status.suspended or status.state in ("Check", "Tool", "Starting"):
            faults.append(f"state {status.state}")
        if status.pins:
            warnings.append(f"input pins {status.pins} are active")
        known = self._homed or self._build.knows_restarts or not self._build.homing_enabled
        return StageStatus(
            moving=status.moving,
            referenced=status.state != "Alarm" and known and not self._link.restarted,
            positions_mm=self._positions(status),
            faults=tuple(faults),
            warnings=tuple(warnings),
        )

    def _do_close(self) -> None:
        self._link.close()

    def _wait_until_synchronised(self, timeout_s: float, asked: str) -> Status:
        """Wait until the planner is empty: Idle, then a dwell that is acknowledged, then Idle."""
        begin_s = self.clock.now_s()
        while True:
            left_s = begin_s + timeout_s - self.clock.now_s()
            self._wait_until_idle(left_s, asked)
            try:
                self._link.command("G4 P0.01", SYNC_TIMEOUT_S)
            except RefusedError as error:
                # Locked although Idle was reported: it is still jogging (grbl issue 1115).
                if error.code != LOCKED_OUT or self.clock.now_s() - begin_s >= timeout_s:
                    raise
                self.incidents.append(f"{self.name}: Idle was reported early")
                self.clock.sleep_s(POLL_S)
            else:
                return self._wait_until_idle(left_s, asked)

    def _wait_until_idle(self, timeout_s: float, asked: str) -> Status:
        begin_s = self.clock.now_s()
        while True:
            status = self._report(asked)
            if self._link.restarted or (status.state == "Alarm" and self._link.alarm is None):
                raise self._restarted(asked, f"state {status.state}")
            if status.state == "Idle":
                return status
            if status.state == "Alarm":
                raise self._link.alarm_error(asked)
            if not status.moving:
                raise MoveFailedError(
                    self.name,
                    asked,
                    [f"state {status.state}"],
                    remedy="close the safety door or release the hold at the controller",
                )
            waited_s = self.clock.now_s() - begin_s
            if waited_s >= timeout_s:
                raise NoAnswerError(
                    self.name, f"{asked}: arrival", waited_s, remedy="look for an obstacle on the stage"
                )
            self.clock.sleep_s(POLL_S)

    def _restarted(self, asked: str, shown: str) -> ReferenceLostError:
        self._link.restarted = True
        why = f"the controller restarted ({shown}" + (
            f"; before: {self._link.suspicion})" if self._link.suspicion else ")"
        )
        return ReferenceLostError(self.name, asked, [why], remedy=f"home the stage: `{HOME_COMMAND}`")

    def _settle(self, status: Status, targets_mm: Mapping[str, float]) -> None:
        """Note where a motion ended; if it could not have ended there, the controller has restarted."""
        self._require_on_path(status, targets_mm)
        self._rest.settle(self._machine_mm(status))

    def _require_on_path(self, status: Status, targets_mm: Mapping[str, float]) -> None:
        targets = {LETTERS.index(axis): target for axis, target in targets_mm.items()}
        suspicious = bool(self._link.suspicion)
        if targets and self._rest.lost(self._machine_mm(status), targets, suspicious=suspicious):
            self._link.restarted = True

    def _report(self, asked: str) -> Status:
        """Request a report; notice a restart by a position at rest that is not the one that was left."""
        try:
            status = self._link.status(asked)
        except NoAnswerError:
            self._link.outlast_silence()
            status = self._link.status(asked)
        if status.moving:
            return status
        found = self._rest.compare(self._machine_mm(status), suspicious=bool(self._link.suspicion))
        if found is None:
            self._require_on_path(status, self._targets)
            return status
        changed, restarted = found
        self._link.suspicion = ""
        if restarted and not self._link.restarted:
            self._link.restarted = True
            self.incidents.append(f"{self.name}: {changed}: the controller restarted, and its position is not known")
        elif changed:
            self.incidents.append(f"{self.name}: {changed}: somebody moved it, and it counted")
        return status

    def _machine_mm(self, status: Status) -> tuple[float, ...]:
        """Return the machine position of every axis of the controller, in mm.

        Raises:
            BadReplyError: Work positions, and their offset is not known.
        """
        return self._rest.machine_mm(status, inches=self._build.inches)

    def _positions(self, status: Status) -> dict[str, float]:
        """Return machine positions on the axes' own steps, in mm."""
        values, here = self._machine_mm(status), {}
        for axis in self._names:
            i = LETTERS.index(axis)
            if i >= len(values):
                raise BadReplyError(self.name, "?", repr(values).encode(), f"no axis {axis}", allowed="x,y,z")
            step = 1.0 / self._build.settings[100 + i]
            here[axis] = round(values[i] / step) * step
        return here
