"""Zaber stages as a `Stage`.

Here: what a stage does, in Zaber's commands. Not here: lines and ids (`link`), numbers (`units`), tables (`flags`).

Speeds: from firmware 7.25 on each move carries its own, and no setting of the device is changed. Older firmware has
only the setting `maxspeed`, which lies in non-volatile memory: if a session is killed meanwhile, the stage stays slow.
So the setting is changed only if the rig file states the value to restore (`own_speed_mm_s`); it is restored when the
stage has arrived, stops or is closed, and on connecting.
"""

from collections.abc import Mapping
from contextlib import suppress

from gs2ci.core.clock import Clock
from gs2ci_drivers.axis import AxisInfo
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    BadReplyError,
    DriverError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    RefusedError,
    UnsupportedError,
)
from gs2ci_drivers.ports import BytePort
from gs2ci_drivers.stage import Stage, StageInfo, StageStatus
from gs2ci_drivers.zaber.flags import INTERRUPTED, OFF_PATH, UNREFERENCED, describe, is_fault
from gs2ci_drivers.zaber.link import ZaberLink
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_drivers.zaber.units import Units

POLL_S = 0.02
POLL_SHARE = 0.05
"""The longer a motion lasts, the less often it is asked for its end, which may be noticed late by this share of it."""
ARRIVAL_STEPS = 2
"""Microsteps by which a finished move may miss its target, on an axis that has no tolerance of its own."""
MM_PER_UM = 1e-3
S_PER_MS = 1e-3
STOP_TIMEOUT_S = 5.0
SILENT = (
    "check power, cable, `address` and `baud` in [stage]; a device that was set to Zaber's binary protocol (9600 baud) "
    "is switched back to ASCII by Zaber Launcher, and firmware 5 (T-Series) has no other: it cannot be used here"
)
"""What may be wrong where nothing answers; of firmware 5: pymodaq-plugins-zaber, README ("only compatible with the
binary protocol")."""
SPEEDS_SINCE = (7, 25)
"""Firmware from which on `move abs` takes a speed of its own."""


class ZaberStage(Stage):
    """One Zaber device with one or more axes.

    Args:
        name: Name in the rig file.
        port: The serial line.
        clock: The clock of all waits.
        options: From the rig file.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, options: ZaberOptions | None = None) -> None:
        super().__init__(name, clock)
        options = options or ZaberOptions()
        self._numbers = dict(options.axes)
        self._units = {axis: Units(options.microstep_mm[axis]) for axis in options.axes}
        self._link = ZaberLink(
            name, port, clock, address=options.address, with_checksum=options.checksums, incidents=self.incidents
        )
        self._resolution = options.resolution
        self._stated_speed = {axis: self._units[axis].speed_data(v) for axis, v in options.own_speed_mm_s.items()}
        self._moves_take_speeds = False
        self._own_speed: dict[str, int] = {}
        self._speed: dict[str, int] = {}
        self._targets: dict[str, int] = {}
        self._flags: tuple[str, ...] = ()

    def _do_connect(self) -> StageInfo:
        self._link.drain()
        try:
            count = self._number(0, "system.axiscount")
        except NoAnswerError as error:
            raise NoAnswerError(self.name, error.asked, error.waited_s, remedy=SILENT) from error
        for axis, number in self._numbers.items():
            if not 1 <= number <= count:
                raise UnsupportedError(
                    self.name, f"axis {axis!r} is number {number}", asked="connect", allowed=f"1 to {count}"
                )
        firmware = self._get(0, "version")
        self._moves_take_speeds = _version(firmware) >= SPEEDS_SINCE
        return StageInfo(
            model=f"Zaber device {self._get(0, 'deviceid')}",
            serial=self._get(0, "system.serial"),
            firmware=firmware,
            axes={axis: self._read_axis(axis) for axis in self._numbers},
        )

    def _read_axis(self, axis: str) -> AxisInfo:
        number, units = self._numbers[axis], self._units[axis]
        self._check_resolution(axis)
        self._own_speed[axis] = self._speed[axis] = self._number(number, "maxspeed")
        stated = self._stated_speed.get(axis)
        if stated is not None and not self._moves_take_speeds and stated != self._own_speed[axis]:
            self.incidents.append(
                f"{self.name}: maxspeed of axis {axis} was {units.speed_mm_s(self._own_speed[axis]):.4g} mm/s, as a "
                f"killed session leaves it; {units.speed_mm_s(stated):.4g} mm/s was put back"
            )
            self._send_speed(axis, stated)
            self._own_speed[axis] = stated
        if self._own_speed[axis] < 1:
            raise BadReplyError(
                self.name,
                "get maxspeed",
                str(self._own_speed[axis]).encode(),
                f"axis {axis} cannot move",
                allowed="1 or more",
            )
        begin_mm_s2, end_mm_s2 = self._ramps_mm_s2(axis)
        return AxisInfo(
            name=axis,
            min_mm=units.mm(self._number(number, "limit.min")),
            max_mm=units.mm(self._number(number, "limit.max")),
            step_mm=units.microstep_mm,
            max_speed_mm_s=units.speed_mm_s(self._own_speed[axis]),
            speed_step_mm_s=units.speed_mm_s(1),
            acceleration_mm_s2=begin_mm_s2,
            braking_mm_s2=end_mm_s2,
            rounding_s=self._optional(number, "motion.accel.ramptime") * S_PER_MS,
            # Within what a servo axis comes to rest: its position goes on to change by some counts.
            window_mm=max(
                self._optional(number, "cloop.settle.tolerance") * MM_PER_UM, ARRIVAL_STEPS * units.microstep_mm
            ),
        )

    def _ramps_mm_s2(self, axis: str) -> tuple[float, float]:
        """Return the accelerations at the begin and the end of a move; older firmware has one setting for both."""
        number, units = self._numbers[axis], self._units[axis]
        ends = [round(self._optional(number, f"motion.{end}")) for end in ("accelonly", "decelonly")]
        begin, end = ends if any(ends) else [self._number(number, "accel")] * 2
        return units.acceleration_mm_s2(begin), units.acceleration_mm_s2(end)

    def _optional(self, number: int, setting: str) -> float:
        """Return a setting's number, 0 where a device has no such setting."""
        try:
            return self._reading(number, setting)
        except RefusedError:
            return 0.0

    def _check_resolution(self, axis: str) -> None:
        """Check that an axis has the microsteps that the rig file states; a direct drive has no such setting."""
        try:
            resolution = self._number(self._numbers[axis], "resolution")
        except RefusedError:
            return
        if resolution != self._resolution:
            microstep_mm = self._units[axis].microstep_mm * self._resolution / resolution
            raise UnsupportedError(
                self.name,
                f"axis {axis} counts {resolution} microsteps per step",
                asked="connect",
                allowed=f"{self._resolution}, for which microstep_mm holds",
                remedy=f"set resolution = {resolution} and microstep_mm = {{ {axis} = {microstep_mm:.6g} }} in [stage]",
            )

    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        self._targets = {}
        self._forget_interruption(self._read_flags())
        for axis in axes:
            self._link.command(self._numbers[axis], "home")
        self._wait_until_idle(timeout_s, "home")
        self._raise_for_flags(self._read_flags(), "home")

    def _do_begin_move(self, targets_mm: Mapping[str, float], speed_mm_s: float) -> None:
        self._forget_interruption(self._flags)
        self._targets = {axis: self._units[axis].steps(target) for axis, target in targets_mm.items()}
        # Rounding must not request more than the device's own speed.
        speeds = {axis: min(self._units[axis].speed_data(speed_mm_s), self._own_speed[axis]) for axis in targets_mm}
        if not self._moves_take_speeds:
            for axis, data in speeds.items():
                self._set_speed(axis, data)
        for axis, steps in self._targets.items():
            own = f" {speeds[axis]}" if self._moves_take_speeds and speeds[axis] != self._own_speed[axis] else ""
            self._link.command(self._numbers[axis], f"move abs {steps}{own}")

    def _do_wait_idle(self, timeout_s: float) -> None:
        asked = f"move to {self._targets} microsteps"
        self._wait_until_idle(timeout_s, asked)
        self._raise_for_flags(self._read_flags(), asked)
        targets, self._targets = self._targets, {}
        for axis, steps in targets.items():
            reached, units = self._number(self._numbers[axis], "pos"), self._units[axis]
            if abs(reached - steps) > self.info.axes[axis].window_mm / units.microstep_mm * (1 + 1e-9):
                raise MoveFailedError(
                    self.name,
                    asked,
                    [f"axis {axis} at rest at {units.mm(reached):.4f} mm, short of its target"],
                    remedy="look for an obstacle on the stage",
                )
        self._restore_speeds()

    def _do_positions_mm(self) -> dict[str, float]:
        return {axis: self._units[axis].mm(self._number(number, "pos")) for axis, number in self._numbers.items()}

    def _do_position_mm(self, axis: str) -> float:
        return self._units[axis].mm(self._number(self._numbers[axis], "pos"))

    def _do_forget_path_faults(self) -> None:
        if OFF_PATH & set(self._read_flags()):
            for number in self._numbers.values():
                self._link.command(number, "warnings clear")

    def _do_path_faults(self) -> tuple[str, ...]:
        return tuple(describe(flag) for flag in self._read_flags() if flag in OFF_PATH or is_fault(flag))

    def _do_stop(self) -> None:
        self._targets = {}
        self._link.drain()
        self._link.query(0, "stop")  # stopping twice is harmless, so it is repeated like a query
        self._wait_until_idle(STOP_TIMEOUT_S, "stop")
        self._restore_speeds()

    def _do_status(self) -> StageStatus:
        busy = self._link.query(0, "").busy
        self._flags = flags = self._read_flags()
        return StageStatus(
            moving=busy,
            referenced=not UNREFERENCED & set(flags),
            unreferenced=", ".join(describe(flag) for flag in flags if flag in UNREFERENCED),
            positions_mm=self._do_positions_mm(),
            faults=tuple(describe(flag) for flag in flags if is_fault(flag)),
            warnings=tuple(describe(flag) for flag in flags if not is_fault(flag)),
        )

    def _do_close(self) -> None:
        try:
            self._restore_speeds()
        except DriverError:  # the line may be dead; closing must still release the port
            self._speed = dict(self._own_speed)
        self._link.close()

    def _wait_until_idle(self, timeout_s: float, asked: str) -> None:
        begin_s = self.clock.now_s()
        while self._link.query(0, "").busy:
            waited_s = self.clock.now_s() - begin_s
            if waited_s >= timeout_s:
                raise NoAnswerError(
                    self.name, f"{asked}: arrival", waited_s, remedy="look for an obstacle on the stage"
                )
            self.clock.sleep_s(max(POLL_S, POLL_SHARE * waited_s))

    def _read_flags(self) -> tuple[str, ...]:
        """Return the flags that are set on any axis in use; another one may have no reference, or no stage at all."""
        return tuple(dict.fromkeys(flag for number in self._numbers.values() for flag in self._flags_of(number)))

    def _flags_of(self, number: int) -> list[str]:
        """Return the flags of one axis (zaber-motion, ascii.Warnings: "on device or axis")."""
        data = self._link.query(number, "warnings").data.split()
        if not data or not data[0].isdigit() or len(data) != int(data[0]) + 1:
            raise BadReplyError(
                self.name, "warnings", " ".join(data).encode(), "not a count and its flags", allowed="NN FF FF ..."
            )
        return data[1:]

    def _forget_interruption(self, flags: tuple[str, ...]) -> None:
        """Clear the flags of an earlier interruption: it must not be taken for one of the motion that begins."""
        if INTERRUPTED & set(flags):
            for number in self._numbers.values():
                self._link.command(number, "warnings clear")

    def _raise_for_flags(self, flags: tuple[str, ...], asked: str) -> None:
        faults = [describe(flag) for flag in flags if is_fault(flag) or flag in INTERRUPTED]
        if faults:
            raise MoveFailedError(
                self.name, asked, faults, remedy="remove the obstacle or the fault, then home if the stage lost steps"
            )
        lost = [describe(flag) for flag in flags if flag in UNREFERENCED]
        if lost:
            raise ReferenceLostError(self.name, asked, lost, remedy=f"home the stage: `{HOME_COMMAND}`")

    def _set_speed(self, axis: str, data: int) -> None:
        """Change the setting `maxspeed`, on firmware without another way; the value to restore must be known."""
        if data == self._speed[axis]:
            return
        if axis not in self._stated_speed:
            own_mm_s = self._units[axis].speed_mm_s(self._own_speed[axis])
            raise UnsupportedError(
                self.name,
                "before firmware 7.25 a speed is a setting that outlives a killed session",
                asked=f"move {axis} at {self._units[axis].speed_mm_s(data):.4g} mm/s",
                allowed=f"its own {own_mm_s:.4g} mm/s",
                remedy=f"set own_speed_mm_s = {{ {axis} = {own_mm_s:.4g} }} in [stage], if that is the axis's own top "
                "speed, or update its firmware",
            )
        self._send_speed(axis, data)

    def _send_speed(self, axis: str, data: int) -> None:
        self._link.query(self._numbers[axis], f"set maxspeed {data}")
        self._speed[axis] = data

    def _restore_speeds(self) -> None:
        for axis, data in self._own_speed.items():
            if self._speed[axis] != data:
                self._send_speed(axis, data)

    def _do_temperatures_c(self) -> dict[str, float]:
        # `driver.temperature`, per axis, is in the setting constants of Zaber's motion library; older firmware and some
        # devices answer BADCOMMAND.
        found = {}
        for axis, number in self._numbers.items():
            with suppress(RefusedError):
                found[axis] = self._reading(number, "driver.temperature")
        return found

    def _get(self, axis: int, setting: str) -> str:
        return self._link.query(axis, f"get {setting}").data

    def _number(self, axis: int, setting: str) -> int:
        return round(self._reading(axis, setting))

    def _reading(self, axis: int, setting: str) -> float:
        text = self._get(axis, setting)
        try:
            found = float(text)
            round(found)  # raises an error for infinities and NaN
        except (ValueError, OverflowError) as error:
            raise BadReplyError(
                self.name, f"get {setting}", text.encode(), "not a number", allowed="a number"
            ) from error
        return found


def _version(text: str) -> tuple[int, ...]:
    """Return a firmware version as numbers; a text that is no version counts as very old."""
    parts = text.split(".")
    return tuple(int(part) for part in parts) if all(part.isdigit() for part in parts) else (0,)
