"""A stage on a GRBL 1.1 controller.

Every motion is a jog (`$J=`): it does not change the parser's modes, is refused as a whole if its target lies outside
the travel, and can be cancelled without losing the position. The end of a motion is checked twice (grbl issue 1115:
Idle can be reported early): first the state is Idle, then a `G4` dwell, which the planner executes last, is
acknowledged.

A soft reset loses the position if the machine moves. It is sent only where nothing else works: to a controller that is
locked or in a homing cycle, and to one that gives no reports, in `stop` and, after the time to boot, in `connect`.

Here: what a stage does. Not here: lines (`link`), formats (`packets`).
"""

from collections.abc import Mapping
from math import hypot

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    BadReplyError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    RefusedError,
    UnsupportedError,
)
from gs2ci_drivers.grbl.link import GrblLink
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.grbl.packets import ALARMS, JOG_CANCEL, Status, jog, parse_setting
from gs2ci_drivers.ports import BytePort
from gs2ci_drivers.stage import AxisInfo, Stage, StageInfo, StageStatus

POLL_S = 0.2
"""The manual asks for at most 5 reports a second while moving."""
STOP_TIMEOUT_S = 5.0
SYNC_TIMEOUT_S = 5.0
LETTERS = ("x", "y", "z")
FEED_STEP_MM_MIN = 0.001
"""Resolution of the feed in the commands."""
ARRIVAL_STEPS = 1.0
REPORT_STEP_MM = 0.001
"""Reports have three decimals."""
LOCKED_OUT = 9
MM_PER_INCH = 25.4
NUMBERS_NEEDED = (13, 22, 100, 110, 120, 130)


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
        self._settings: dict[int, float] = {}
        self._offset: tuple[float, ...] | None = None
        self._targets: dict[str, float] = {}
        self._homing = False

    def _do_connect(self) -> StageInfo:
        self._link.await_boot()
        self._settings = dict(
            setting for line in self._link.command("$$") if (setting := parse_setting(line)) is not None
        )
        for number in NUMBERS_NEEDED:
            if number not in self._settings:
                raise BadReplyError(self.name, "$$", b"", f"setting ${number} is missing", allowed="GRBL 1.1")
        version = next((line for line in self._link.command("$I") if line.startswith("[VER:")), "")
        return StageInfo(
            model="GRBL controller",
            serial="",
            firmware=version.removeprefix("[VER:").rstrip("]:"),
            axes={axis: self._axis_info(axis) for axis in self._names},
        )

    def _axis_info(self, axis: str) -> AxisInfo:
        i = LETTERS.index(axis)
        values = [self._settings.get(base + i, 0.0) for base in (100, 110, 120, 130)]
        if min(values) <= 0:
            raise BadReplyError(
                self.name, "$$", b"", f"settings of axis {axis} are not positive: {values}", allowed="above 0"
            )
        steps_per_mm, speed_mm_min, acceleration, travel = values
        return AxisInfo(
            name=axis,
            min_mm=-travel,
            max_mm=0.0,
            step_mm=1.0 / steps_per_mm,
            max_speed_mm_s=speed_mm_min / 60.0,
            speed_step_mm_s=FEED_STEP_MM_MIN / 60.0,
            acceleration_mm_s2=acceleration,
        )

    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        if not self._settings.get(22):
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
        self._homing = True
        try:
            self._link.command("$H", timeout_s)
        except RefusedError:
            self._homing = False  # it has not begun: `stop` need not reset
            raise
        self._homing = self._link.restarted = False
        self._link.alarm = None

    def _do_begin_move(self, targets_mm: Mapping[str, float], speed_mm_s: float) -> None:
        here = self._do_positions_mm()
        shares = [targets_mm[axis] - here[axis] for axis in targets_mm]
        longest = max(abs(share) for share in shares)
        path_mm_s = speed_mm_s * hypot(*shares) / longest if longest else speed_mm_s
        self._targets = dict(targets_mm)
        self._link.command(jog(targets_mm, path_mm_s * 60.0))

    def _do_wait_idle(self, timeout_s: float) -> None:
        asked = f"move to {self._targets} mm" if self._targets else "wait"
        status = self._wait_until_synchronised(timeout_s, asked)
        targets, self._targets = self._targets, {}
        here = self._positions(status)
        for axis, target in targets.items():
            window_mm = ARRIVAL_STEPS * self.info.axes[axis].step_mm + REPORT_STEP_MM
            if abs(here[axis] - target) > window_mm:
                raise MoveFailedError(
                    self.name,
                    asked,
                    [f"axis {axis} at rest at {here[axis]:.4f} mm, short of its target"],
                    remedy="the motion was cancelled: look for an obstacle or a pressed button",
                )

    def _do_positions_mm(self) -> dict[str, float]:
        return self._positions(self._link.status("position"))

    def _do_stop(self) -> None:
        self._targets = {}
        self._link.drain("stop")
        if self._homing or self._link.locked or not self._cancel_jog():
            self._link.reset()
            self._homing = False

    def _cancel_jog(self) -> bool:
        """Cancel a jog and wait for its end; return False if the controller does not report it."""
        begin_s = self.clock.now_s()
        while True:
            self._link.send(JOG_CANCEL, "stop")
            try:
                state = self._link.status("stop").state
            except (NoAnswerError, MoveFailedError):
                return False
            if state not in ("Jog", "Run", "Home"):
                return True
            waited_s = self.clock.now_s() - begin_s
            if waited_s > STOP_TIMEOUT_S:
                raise NoAnswerError(self.name, "stop", waited_s, remedy="cut the stage's power")
            self.clock.sleep_s(POLL_S)

    def _do_status(self) -> StageStatus:
        try:
            status = self._link.status("status")
        except MoveFailedError as error:  # locked: it reports no position, and nothing moves
            return StageStatus(moving=False, referenced=False, faults=error.faults)
        faults, warnings = [], []
        if status.state == "Alarm" and self._link.alarm is not None:
            faults.append(f"ALARM:{self._link.alarm} ({ALARMS.get(self._link.alarm, 'unknown alarm')})")
        if status.state in ("Door", "Hold", "Sleep", "Check"):
            faults.append(f"state {status.state}")
        if not self._settings.get(22):
            warnings.append("homing is disabled ($22=0): positions count from power-on")
        if status.pins:
            warnings.append(f"input pins {status.pins} are active")
        return StageStatus(
            moving=status.state in ("Jog", "Run", "Home"),
            referenced=status.state != "Alarm" and not self._link.restarted,
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
                if error.code != f"error:{LOCKED_OUT}" or self.clock.now_s() - begin_s >= timeout_s:
                    raise
                self.incidents.append(f"{self.name}: Idle was reported early")
                self.clock.sleep_s(POLL_S)
            else:
                return self._wait_until_idle(left_s, asked)

    def _wait_until_idle(self, timeout_s: float, asked: str) -> Status:
        begin_s = self.clock.now_s()
        while True:
            status = self._link.status(asked)
            if self._link.restarted:
                raise ReferenceLostError(
                    self.name,
                    asked,
                    ["the controller restarted"],
                    remedy=f"home the stage: `{HOME_COMMAND}`",
                )
            if status.state == "Idle":
                return status
            if status.state == "Alarm":
                raise self._link.alarm_error(asked)
            if status.state not in ("Jog", "Run", "Home"):
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

    def _positions(self, status: Status) -> dict[str, float]:
        """Return machine positions on the axes' own steps, in mm."""
        if status.offset is not None:
            self._offset = status.offset
        values = status.machine
        if values is None:
            if self._offset is None or status.work is None or len(self._offset) != len(status.work):
                raise BadReplyError(
                    self.name,
                    "?",
                    b"WPos",
                    "a work position without its offset",
                    allowed="machine positions: set $10=1",
                )
            values = tuple(work + offset for work, offset in zip(status.work, self._offset, strict=True))
        unit = MM_PER_INCH if self._settings.get(13) else 1.0
        if len(values) < len(LETTERS):
            raise BadReplyError(self.name, "?", repr(values).encode(), "fewer than three axes", allowed="x,y,z")
        here = {}
        for axis in self._names:
            step = 1.0 / self._settings[100 + LETTERS.index(axis)]
            here[axis] = round(values[LETTERS.index(axis)] * unit / step) * step
        return here
