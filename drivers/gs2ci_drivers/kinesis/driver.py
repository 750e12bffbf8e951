"""Thorlabs stages as a `Stage`.

Here: what a stage does, in messages of the APT protocol. Not here: bytes (`packets`, `link`), numbers (`stages`).

- The reference is lost when the controller loses power, whatever the encoder showed (MGMSG_MOT_SET_POSCOUNTER: "the
  position is unknown as the stage is free to move when the power is off").
- The speed of a move is a parameter of the channel, in memory that power clears. It is set before each move, its
  acceleration is left as it is; what was found is put back on closing. A session that was killed leaves its own speed
  behind, so the highest speed is the model's, not the one that is found.
- A move in reverse passes its target and comes back to it, unless the channel's backlash distance is 0
  (MGMSG_MOT_SET_GENMOVEPARAMS): a sweep would turn round at its end instead of resting, and reach beyond the travel.
  The distance is set to 0 before the first move, and put back on closing; what play the screw has is the calibration's.
- A move is not acknowledged, and its end is told by a message that other programs may have switched off
  (MGMSG_MOT_SUSPEND_ENDOFMOVEMSGS): the driver asks for the state instead. For a moment after the request the status
  does not yet show the motion; a move counts as begun for that long.
- Brushless controllers read counts and travel from the stage's plug: another stage than the rig file's is refused.
- A stop decelerates (parameter 2); at once (1) loses the position of stepper motors.
"""

import struct
from collections.abc import Mapping
from dataclasses import replace

from gs2ci.core.clock import Clock
from gs2ci_drivers.axis import AxisInfo
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    BadReplyError,
    DriverError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    UnsupportedError,
)
from gs2ci_drivers.kinesis.link import AptLink
from gs2ci_drivers.kinesis.options import KinesisOptions
from gs2ci_drivers.kinesis.packets import (
    CHANNEL,
    CUBE,
    ENDED_BY,
    FAULTS,
    FIRST_BAY,
    MOTHERBOARD,
    MOVING,
    PROFILED_STOP,
    STAGE_AXIS_BYTES,
    AptStatus,
    Message,
    move_absolute,
    parse_info,
    parse_stage_memory,
    set_homing,
    set_overshoot,
    set_speed,
    short,
)
from gs2ci_drivers.kinesis.stages import BRUSHLESS_SAMPLE_S, STAGES
from gs2ci_drivers.ports import BytePort
from gs2ci_drivers.stage import Stage, StageInfo, StageStatus

POLL_S = 0.02
STOP_TIMEOUT_S = 5.0
HOME_WAY, HOME_SPARE_S = 1.5, 30.0
"""Of the travel, at the speed of homing, and what follows: the way back from the switch."""
HOME_SHARE = 0.5
"""Of the highest speed, for a channel without a speed of homing; it then homes in reverse, where positions begin."""
REVERSE, REVERSE_SWITCH = 2, 1
BEGIN_S = 0.1
"""How long after a request the status may not show the motion yet."""
ARRIVAL_MM = 2e-3
"""By how much a servo at rest may miss its target: above the repeatability of the Z8 stages (1.6 um)."""


class KinesisStage(Stage):
    """One controller with one axis, or with one per bay.

    Args:
        name: Name in the rig file.
        port: The serial line.
        clock: The clock of all waits.
        options: From the rig file.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, options: KinesisOptions | None = None) -> None:
        super().__init__(name, clock)
        options = options or KinesisOptions()
        self._bays = dict(options.axes)
        self._dest = {axis: FIRST_BAY + bay - 1 if bay else CUBE for axis, bay in options.axes.items()}
        self._models = {
            axis: replace(STAGES[model], counts_per_mm=options.counts_per_mm.get(axis, STAGES[model].counts_per_mm))
            for axis, model in options.stages.items()
        }
        self._unstated = options.stages.keys() - options.counts_per_mm.keys()
        self._main = MOTHERBOARD if any(options.axes.values()) else CUBE
        sources = frozenset({self._main, *self._dest.values()})
        self._link = AptLink(name, port, clock, sources=sources, incidents=self.incidents)
        self._found: dict[str, tuple[int, int]] = {}
        self._set: dict[str, int] = {}
        self._overshoots: dict[str, int] = {}
        self._straight: set[str] = set()
        self._targets: dict[str, int] = {}
        self._begun_s = -BEGIN_S

    def _do_connect(self) -> StageInfo:
        # Ends what another program may have left running; it is a matter of the line and changes no setting.
        self._link.send(short(Message.HW_STOP_UPDATEMSGS, self._main, 0), "stop status updates")
        info = parse_info(self._link.ask(Message.HW_REQ_INFO, self._main, 84, 0).data)
        assert info is not None  # the link has checked the length
        highest = max(self._bays.values())
        if highest > info.channels:
            raise UnsupportedError(
                self.name,
                f"{info.model} has {info.channels} bays, an axis is in bay {highest}",
                asked="connect",
                allowed=f"1 to {info.channels}",
                remedy="correct `axes` in [stage]",
            )
        return StageInfo(
            model=f"Thorlabs {info.model}",
            serial=str(info.serial),
            firmware=info.firmware,
            axes={axis: self._read_axis(axis) for axis in self._dest},
        )

    def _read_axis(self, axis: str) -> AxisInfo:
        model, dest = self._models[axis], self._dest[axis]
        self._require_stage(axis)
        data = self._link.ask(Message.MOT_REQ_VELPARAMS, dest, 14).data
        _, _, acceleration, speed = struct.unpack_from("<Hiii", data)
        if acceleration < 1:
            asked = "MGMSG_MOT_REQ_VELPARAMS"
            raise BadReplyError(self.name, asked, data, f"axis {axis} has no acceleration", allowed="1 or more")
        self._found[axis], self._set[axis] = (acceleration, speed), speed
        self._overshoots[axis] = self._long(Message.MOT_REQ_GENMOVEPARAMS, axis)
        return AxisInfo(
            name=axis,
            min_mm=0.0,
            max_mm=model.travel_mm,
            step_mm=model.mm(1),
            max_speed_mm_s=model.max_speed_mm_s,
            speed_step_mm_s=model.speed_unit_mm_s,
            acceleration_mm_s2=acceleration * model.acceleration_unit_mm_s2,
            window_mm=ARRIVAL_MM,
        )

    def _require_stage(self, axis: str) -> None:
        """Compare a stage with what its plug tells, unless the rig file states its counts.

        Raises:
            UnsupportedError: It is another one.
        """
        model, request = self._models[axis], Message.MOT_REQ_PMDSTAGEAXISPARAMS
        if axis not in self._unstated or model.sample_s != BRUSHLESS_SAMPLE_S:
            return
        try:
            answer = self._link.ask_once(request, self._dest[axis], STAGE_AXIS_BYTES, f"MGMSG_{request.name}")
        except (NoAnswerError, BadReplyError):
            return  # nothing depends on it, and firmware may lack it
        found = parse_stage_memory(answer.data)
        if found is None:
            return
        if found.counts_per_unit != model.counts_per_mm or found.travel < 0.99 * model.travel_mm:
            raise UnsupportedError(
                self.name,
                f"the controller has read from the plug of axis {axis}: {found.part or 'no part number'}, "
                f"{found.counts_per_unit} counts per mm, {found.travel:.4g} mm of travel",
                asked="connect",
                allowed=f"{model.counts_per_mm:.8g} counts per mm and {model.travel_mm:.4g} mm, as `stages` has it",
                remedy="correct `stages` or `axes` in [stage]; with counts_per_mm for this axis nothing is compared",
            )

    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        self._targets = {}
        for axis in axes:
            # Its power may have been cut, and with that all settings are those of its own memory again.
            self._set.pop(axis, None)
            self._straight.discard(axis)
            self._enable(axis)
            self._give_home_speed(axis)
            self._link.send(short(Message.MOT_MOVE_HOME, self._dest[axis]), f"home {axis}")
        self._begun_s = self.clock.now_s()
        self._wait_at_rest(timeout_s, "home")
        missed = [axis for axis in axes if not self._bits(axis) & AptStatus.HOMED]
        if missed:
            raise MoveFailedError(
                self.name,
                "home",
                [f"axis {axis} is at rest without a reference" for axis in missed],
                remedy="look for an obstacle on the stage, then home it again",
            )

    def _do_home_time_s(self, axes: tuple[str, ...]) -> float:
        # They home together, each at a speed of its own, which another program may have set.
        return max(self._home_time_s(axis) for axis in axes)

    def _home_time_s(self, axis: str) -> float:
        model, speed = self._models[axis], abs(self._homing(axis)[2]) * self._models[axis].speed_unit_mm_s
        return HOME_SPARE_S + HOME_WAY * model.travel_mm / (speed or model.max_speed_mm_s * HOME_SHARE)

    def _homing(self, axis: str) -> tuple[int, int, int, int]:
        """Ask how a channel homes: direction, limit switch, speed, offset."""
        data = self._link.ask(Message.MOT_REQ_HOMEPARAMS, self._dest[axis], 14).data
        direction, switch, speed, offset = struct.unpack_from("<HHii", data, 2)
        return direction, switch, speed, offset

    def _give_home_speed(self, axis: str) -> None:
        """Give a channel a speed of homing that has none: Kinesis sets it at each start, and some do not keep it."""
        direction, switch, speed, offset = self._homing(axis)
        if speed:
            return
        model = self._models[axis]
        speed = round(model.max_speed_mm_s * HOME_SHARE / model.speed_unit_mm_s)
        how = (direction or REVERSE, switch or REVERSE_SWITCH, speed, offset)
        self._link.send(set_homing(self._dest[axis], *how), f"set the speed of homing of {axis}")
        self.incidents.append(
            f"{self.name}: axis {axis} had no speed of homing, and got {model.max_speed_mm_s * HOME_SHARE:.3g} mm/s"
        )

    def _do_begin_move(self, targets_mm: Mapping[str, float], speed_mm_s: float) -> None:
        self._targets = {axis: self._models[axis].counts(target) for axis, target in targets_mm.items()}
        for axis, counts in self._targets.items():
            self._enable(axis)
            self._end_on_targets(axis)
            self._set_speed(axis, max(1, round(speed_mm_s / self._models[axis].speed_unit_mm_s)))
            self._link.send(move_absolute(self._dest[axis], counts), f"move {axis} to {counts} counts")
        self._begun_s = self.clock.now_s()
        # Moves are not acknowledged: an answer to a question behind them says at least that the line has not broken.
        for axis in self._targets:
            self._link.ask_once(Message.MOT_REQ_STATUSBITS, self._dest[axis], 6, f"move {axis}")

    def _do_wait_idle(self, timeout_s: float) -> None:
        asked = f"move to {self._targets} counts"
        self._wait_at_rest(timeout_s, asked)
        targets, self._targets = self._targets, {}
        for axis, counts in targets.items():
            bits, model = self._bits(axis), self._models[axis]
            if not bits & AptStatus.HOMED:
                raise ReferenceLostError(
                    self.name,
                    asked,
                    [f"axis {axis} has no reference any more"],
                    remedy=f"the controller lost power: home the stage with `{HOME_COMMAND}`",
                )
            reached_mm = model.mm(self._position(axis))
            if abs(reached_mm - model.mm(counts)) > ARRIVAL_MM:
                faults = [words for bit, words in ENDED_BY.items() if bits & bit]
                raise MoveFailedError(
                    self.name,
                    asked,
                    [f"axis {axis} at rest at {reached_mm:.4f} mm, short of its target", *faults],
                    remedy="look for an obstacle, or for somebody at the cube's wheel",
                )

    def _do_positions_mm(self) -> dict[str, float]:
        return {axis: self._models[axis].mm(self._position(axis)) for axis in self._dest}

    def _do_position_mm(self, axis: str) -> float:
        return self._models[axis].mm(self._position(axis))

    def _do_path_faults(self) -> tuple[str, ...]:
        return _faults({axis: self._bits(axis) for axis in self._dest})

    def _do_stop(self) -> None:
        self._targets, self._begun_s = {}, self.clock.now_s()
        for axis, dest in self._dest.items():
            self._link.send(short(Message.MOT_MOVE_STOP, dest, CHANNEL, PROFILED_STOP), f"stop {axis}")
        self._wait_at_rest(STOP_TIMEOUT_S, "stop")

    def _do_status(self) -> StageStatus:
        bits = {axis: self._bits(axis) for axis in self._dest}
        positions_mm = self._do_positions_mm()
        return StageStatus(
            moving=any(word & MOVING for word in bits.values()) or self._may_begin(),
            referenced=all(word & AptStatus.HOMED for word in bits.values()),
            positions_mm=positions_mm,
            faults=_faults(bits),
            warnings=tuple(
                f"axis {axis}: at a limit switch"
                for axis, word in bits.items()
                if word & (AptStatus.FORWARD_LIMIT | AptStatus.REVERSE_LIMIT)
            ),
        )

    def _do_close(self) -> None:
        try:
            for axis, (acceleration, speed) in self._found.items():
                if self._set.get(axis) != speed:
                    self._link.send(set_speed(self._dest[axis], acceleration, speed), "put the speed back")
            for axis in self._straight:
                if counts := self._overshoots[axis]:
                    self._link.send(set_overshoot(self._dest[axis], counts), "put the backlash distance back")
        except DriverError:  # the line may be dead; closing must still release the port
            self._found = {}
        self._link.close()

    def _may_begin(self) -> bool:
        """Return whether a move that was asked for just now may not show in the status yet."""
        return bool(self._targets) and self.clock.now_s() - self._begun_s < BEGIN_S and not self._all_arrived()

    def _all_arrived(self) -> bool:
        return all(abs(self._position(axis) - counts) <= 1 for axis, counts in self._targets.items())

    def _wait_at_rest(self, timeout_s: float, asked: str) -> None:
        """Wait until no axis moves, nor may still begin to."""
        begin_s, still_since_s = self.clock.now_s(), None
        while True:
            now_s = self.clock.now_s()
            if any(self._bits(axis) & MOVING for axis in self._dest):
                still_since_s = None
            elif still_since_s is None:
                still_since_s = now_s
            # At rest: it has been seen at rest after the time within which a request shows in the status.
            if still_since_s is not None and (now_s - self._begun_s >= BEGIN_S or self._arrived_early()):
                return
            if now_s - begin_s >= timeout_s:
                raise NoAnswerError(
                    self.name, f"{asked}: arrival", now_s - begin_s, remedy="look for an obstacle on the stage"
                )
            self.clock.sleep_s(POLL_S)

    def _arrived_early(self) -> bool:
        return bool(self._targets) and self._all_arrived()

    def _bits(self, axis: str) -> int:
        return self._long(Message.MOT_REQ_STATUSBITS, axis) & 0xFFFFFFFF

    def _position(self, axis: str) -> int:
        return self._long(Message.MOT_REQ_POSCOUNTER, axis)

    def _long(self, request: Message, axis: str) -> int:
        """Ask for a number of a channel, of 32 bits with a sign."""
        return int(struct.unpack_from("<Hi", self._link.ask(request, self._dest[axis], 6).data)[1])

    def _enable(self, axis: str) -> None:
        """Switch a channel's motor on; benchtop controllers begin with it off."""
        if not self._bits(axis) & AptStatus.ENABLED:
            self._link.send(short(Message.MOD_SET_CHANENABLESTATE, self._dest[axis], CHANNEL, 1), f"enable {axis}")
            self.incidents.append(f"{self.name}: the motor of axis {axis} was off and has been switched on")

    def _end_on_targets(self, axis: str) -> None:
        """Have moves in reverse end where they are told to, instead of passing their target and coming back."""
        if axis in self._straight:
            return
        if counts := self._overshoots[axis]:
            self._link.send(set_overshoot(self._dest[axis], 0), f"set the backlash distance of {axis}")
            self.incidents.append(
                f"{self.name}: moves of axis {axis} in reverse passed their target by "
                f"{self._models[axis].mm(counts):.3g} mm and came back; this is off until the stage is closed"
            )
        self._straight.add(axis)

    def _set_speed(self, axis: str, speed: int) -> None:
        if speed != self._set.get(axis):
            self._link.send(set_speed(self._dest[axis], self._found[axis][0], speed), f"set the speed of {axis}")
            self._set[axis] = speed


def _faults(bits: Mapping[str, int]) -> tuple[str, ...]:
    """Return in words the faults among the status bits of axes."""
    return tuple(f"axis {axis}: {words}" for axis in bits for bit, words in FAULTS.items() if bits[axis] & bit)
