"""The twin of a Zaber stage: its firmware's ASCII protocol over a `SerialTwin`, its axes as `AxisMotion`.

It parses and writes messages with its own code, so that it does not share a mistake of the driver's. Settings, warning
flags, rejections, alerts, pre-emption and faults are as in reference 3.1 and 3.5. Each axis has flags of its own; a
request to axis 0 gets those of all (zaber-motion, ascii.Warnings: "warnings and faults on device or axis").

Closed-loop devices report what their encoder sees: one that stalls may recover and arrive, with the flag WS (ASCII
protocol manual, Warning flags). `warnings clear` lists the flags of before (inferred: the maker's library raises only
then). After a loss of power the axis counts from 0 where it stands, until it has found its home sensor. `move abs`
accepts a speed and an acceleration for this move (zaber-motion, Axis.move_absolute: "velocity: ... requires at least
firmware 7.25"). Not here: the byte level (`serial_twin`), the driver.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from gs2ci.core.mechanics import Mechanics
from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.disturbed import Disturbances
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import VirtualClock, World

PRIORITY = ("FF", "FH", "FV", "FC", "FM", "FD", "FO", "FQ", "FE", "FS", "WR", "WH", "WL", "WS", "WM", "NI", "NC")
SPEED_SCALE = 1.6384
HOMING_SPEED_SHARE = 0.5
CLEARED = frozenset({"NI", "NC", "FS", "FE", "WL", "FH", "WS", "WM"})
"""Flags that `warnings clear` takes away; the others last as long as their cause."""


@dataclass
class ZaberAxis:
    """One axis as built.

    Args:
        microstep_mm: Travel of one microstep.
        min_steps: `limit.min`.
        max_steps: `limit.max`.
        max_speed: `maxspeed`, in speed data.
        acceleration: `accel`, in acceleration data.
        start_mm: Position at power-on.
        mechanics: The errors between counted and true position.
    """

    microstep_mm: float = 0.000047625
    min_steps: int = 0
    max_steps: int = 3149606
    max_speed: int = 1376257
    acceleration: int = 1720
    start_mm: float = 75.0
    mechanics: Mechanics = field(default_factory=Mechanics)


class _RejectedError(Exception):
    """A command that the device rejects, with the word of its reply."""


class _Axis:
    """An axis with its live settings and its warning flags."""

    def __init__(self, built: ZaberAxis, *, referenced: bool) -> None:
        self.built = built
        self.flags: set[str] = set() if referenced else {"WR"}
        self.max_speed = built.max_speed
        acceleration_mm_s2 = built.acceleration * 1e4 / SPEED_SCALE * built.microstep_mm
        self.motion = AxisMotion(built.start_mm, acceleration_mm_s2, built.mechanics)

    def speed_mm_s(self, speed: int | None = None) -> float:
        return (speed or self.max_speed) / SPEED_SCALE * self.built.microstep_mm

    def steps_at(self, when_s: float) -> int:
        return round(self.motion.position_at(when_s) / self.built.microstep_mm)


class ZaberTwin(SerialTwin):
    """A Zaber device with its axes, named as in the rig; number i + 1 is the i-th.

    Args:
        clock: The world's clock.
        axes: Its axes.
        faults: The faults to inject.
        address: Its address.
        referenced: Whether its position is known at power-on (with an absolute encoder, or homed before).

    Settings such as `maxspeed` are kept in non-volatile memory (Zaber ASCII protocol manual, device settings): they
    remain after a session that ended without restoring them, and after a power cycle.
    """

    def __init__(
        self,
        clock: VirtualClock,
        axes: Mapping[str, ZaberAxis] | None = None,
        faults: FaultSet | None = None,
        *,
        address: int = 1,
        referenced: bool = True,
    ) -> None:
        super().__init__(clock, faults)
        self._address = address
        self._names = tuple(axes or {"x": ZaberAxis()})
        self._axes = [_Axis(axis, referenced=referenced) for axis in (axes or {"x": ZaberAxis()}).values()]
        self._replies_checked = False
        self._busy_until_s = 0.0
        self._generation = 0
        self.disturbances = Disturbances(clock, self.faults)

    @property
    def terminators(self) -> bytes:
        """Get line feed and carriage return."""
        return b"\r\n"

    def positions_mm_at(self, when_s: float) -> dict[str, float]:
        """Return the true positions of the carriages."""
        return {name: axis.motion.true_position_at(when_s) for name, axis in zip(self._names, self._axes, strict=True)}

    def power_cycle(self) -> None:
        """Cut the power for a moment: motion ends, the reference is lost; settings are kept."""
        now_s = self.clock.now_s()
        self._generation += 1
        self._incoming = b""
        for axis in self._axes:
            axis.motion.halt(now_s)
            axis.motion.set_position(0.0, now_s)
            axis.flags = {"WR"}
        self._replies_checked = False

    def release(self) -> None:
        """Do what a user does after a fault: release the emergency stop, restore the supply, enable the driver."""
        self._clear(0, {"FH", "FV", "FD", "FO"})

    def _stale(self) -> bytes:
        return self._framed("@", f"{self._address:02d} 0 57 OK IDLE -- 123456")

    def _line(self, line: bytes) -> None:
        text = line.decode("ascii", "replace")
        if not text.startswith("/"):
            return  # devices ignore lines that do not begin with a slash
        body = text[1:]
        if len(body) > 3 and body[-3] == ":":
            body, found = body[:-3], body[-2:]
            if f"{-sum(body.encode('ascii', 'replace')) & 0xFF:02X}" != found.upper():
                return  # a message with a transmission error is not answered
            self._replies_checked = True
        numbers: list[int] = []
        words = body.split()
        while words and len(numbers) < 3 and words[0].isdigit():
            numbers.append(int(words.pop(0)))
        address, axis, *message_id = [*numbers, *[0] * max(0, 2 - len(numbers))]
        if address in (0, self._address):
            self._answer(axis, message_id[0] if message_id else None, words)

    def _answer(self, number: int, message_id: int | None, words: list[str]) -> None:
        text = " ".join(words)
        accepted = True
        try:
            data = self._done(number, words, text)
        except _RejectedError as rejected:
            accepted, data = False, str(rejected)
        self._send(number, message_id, text, accepted=accepted, data=data)

    def _done(self, number: int, words: list[str], text: str) -> str:
        """Do what a message asks; return the data of the reply."""
        if number > len(self._axes):
            raise _RejectedError("BADAXIS")
        if not words:
            return "0"
        for fault, rejection in (("zaber.reject", "AGAIN"), ("zaber.bad_data", "BADDATA")):
            if self.faults.take(fault, text):
                raise _RejectedError(rejection)
        handler = getattr(self, f"_do_{words[0]}", None)
        if handler is None:
            raise _RejectedError("BADCOMMAND")
        return handler(number, words[1:]) or "0"

    def _send(self, number: int, message_id: int | None, text: str, *, accepted: bool, data: str) -> None:
        take = self.faults.take
        address = self._address + 1 if take("zaber.wrong_address", text) else self._address
        if message_id is not None and take("zaber.wrong_id", text):
            message_id = (message_id + 50) % 100
        marked = "" if message_id is None else f" {message_id:02d}"
        result = f"{'OK' if accepted else 'RJ'} {'BUSY' if self._busy() else 'IDLE'} {self._warning(number)}"
        line = self._framed("@", f"{address:02d} {number}{marked} {result} {data}")
        if self._replies_checked and take("zaber.bad_checksum", text):
            line = line[:-4] + (b"00" if line[-4:-2] != b"00" else b"01") + b"\r\n"
        alert = self._framed("!", f"{self._address:02d} 1 IDLE {self._warning(1)}")
        if take("zaber.alert", text):
            line = alert + line
        if take("zaber.alert_inside", text):
            line = line[: len(line) // 2] + alert + line[len(line) // 2 :]
        self._reply(line, text)

    def _framed(self, marker: str, body: str) -> bytes:
        check = f":{-sum(body.encode('ascii')) & 0xFF:02X}" if self._replies_checked else ""
        return f"{marker}{body}{check}\r\n".encode("ascii")

    def _busy(self) -> bool:
        now_s = self.clock.now_s()
        return now_s < self._busy_until_s or any(axis.motion.moving_at(now_s) for axis in self._axes)

    def _warning(self, number: int) -> str:
        return next(iter(self._flags(number)), "--")

    def _flags(self, number: int) -> list[str]:
        """Return the flags of an axis, or of all for 0, highest first."""
        found = set().union(*(axis.flags for axis in self._chosen(number)))
        return [flag for flag in PRIORITY if flag in found]

    def _clear(self, number: int, flags: set[str]) -> None:
        for axis in self._chosen(number):
            axis.flags -= flags

    def _chosen(self, number: int) -> list[_Axis]:
        """Return an axis; all for 0 and for a number that no axis has."""
        return self._axes[number - 1 : number] or self._axes

    def _do_get(self, number: int, words: list[str]) -> str:
        setting = words[0] if words else ""
        whole = {
            "deviceid": "50081",
            "version": "7.28",
            "system.serial": "48915",
            "system.axiscount": str(len(self._axes)),
            "comm.checksum": str(int(self._replies_checked)),
            "comm.alert": "0",
        }
        if setting in whole:
            return whole[setting]
        now_s = self.clock.now_s()
        values = []
        for axis in self._chosen(number):
            of_axis = {
                "pos": axis.steps_at(now_s),
                "limit.min": axis.built.min_steps,
                "limit.max": axis.built.max_steps,
                "limit.home.triggered": int("WR" not in axis.flags),
                "maxspeed": axis.max_speed,
                "accel": axis.built.acceleration,
                "motion.accelonly": axis.built.acceleration,
                "motion.decelonly": axis.built.acceleration,
                "motion.accel.ramptime": 0.0,
                "resolution": 64,
                "driver.temperature": 31.4,
            }
            if setting not in of_axis:
                raise _RejectedError("BADCOMMAND")
            values.append(str(of_axis[setting]))
        return " ".join(values)

    def _do_set(self, number: int, words: list[str]) -> None:
        if len(words) != 2 or not words[1].isdigit():
            raise _RejectedError("BADDATA")
        if words[0] == "comm.checksum":
            self._replies_checked = words[1] == "1"
        elif words[0] == "maxspeed" and 1 <= int(words[1]) <= 10 * self._axes[0].built.max_speed:
            for axis in self._chosen(number):
                axis.max_speed = int(words[1])
        elif words[0] == "maxspeed":
            raise _RejectedError("BADDATA")
        elif words[0] != "comm.alert":
            raise _RejectedError("BADCOMMAND")

    def _do_warnings(self, number: int, words: list[str]) -> str:
        flags = self._flags(number)
        if words == ["clear"]:
            self._clear(number, set(CLEARED))
        return " ".join([f"{len(flags):02d}", *flags])

    def _do_stop(self, number: int, words: list[str]) -> None:
        now_s = self.clock.now_s()
        for axis in self._chosen(number):
            if axis.motion.moving_at(now_s):
                axis.flags.add("NI")
                axis.motion.stop(now_s)
        self._busy_until_s = 0.0
        self._generation += 1

    def _do_estop(self, number: int, words: list[str]) -> None:
        self._end_motion(self._chosen(number), "NI")

    def _do_driver(self, number: int, words: list[str]) -> None:
        if words == ["disable"]:
            self._end_motion(self._chosen(number), "FO")
        elif words == ["enable"]:
            self._clear(number, {"FO", "FD", "FV", "FH"})
        else:
            raise _RejectedError("BADCOMMAND")

    def _do_home(self, number: int, words: list[str]) -> None:
        self._need_driver(number)
        now_s = self.clock.now_s()
        for axis in self._chosen(number):
            home_mm = axis.motion.counted_mm(0.0)
            ends_s = axis.motion.move_to(home_mm, axis.speed_mm_s() * HOMING_SPEED_SHARE, now_s)
            axis.flags -= {"FS", "FE"}
            self._schedule_faults(axis, now_s, ends_s, "home")
            self._schedule_reference(axis, ends_s)

    def _schedule_reference(self, axis: _Axis, ends_s: float) -> None:
        """Give an axis its reference when it gets home, unless it has been stopped or moved elsewhere before."""

        def arrive() -> None:
            if axis.motion.ends_s == ends_s:
                axis.motion.set_position(0.0, ends_s)
                axis.flags -= {"WR", "WH"}

        self.clock.at(ends_s, arrive)

    def _do_move(self, number: int, words: list[str]) -> None:
        kinds = {"abs": 2, "rel": 2, "vel": 2, "min": 1, "max": 1}
        if not words or words[0] not in kinds or not kinds[words[0]] <= len(words) <= kinds[words[0]] + 2:
            raise _RejectedError("BADCOMMAND")
        speeds = words[kinds[words[0]] :]
        self._need_driver(number)
        try:
            value = int(words[1]) if kinds[words[0]] > 1 else 0
            speed = int(speeds[0]) if speeds else None
        except ValueError:
            raise _RejectedError("BADDATA") from None
        now_s = self.clock.now_s()
        for axis in self._chosen(number):
            if axis.motion.moving_at(now_s):
                axis.flags.add("NI")
            axis.flags -= {"FS", "FE", "WL"}
            self._move_axis(axis, words[0], value, now_s, speed)

    def _move_axis(self, axis: _Axis, kind: str, value: int, now_s: float, speed: int | None) -> None:
        built = axis.built
        if kind == "vel":
            axis.motion.move_at(value / SPEED_SCALE * built.microstep_mm, now_s)
            return
        target = {
            "abs": value,
            "rel": axis.steps_at(now_s) + value,
            "min": built.min_steps,
            "max": built.max_steps,
        }[kind]
        if not built.min_steps <= target <= built.max_steps:
            raise _RejectedError("BADDATA")
        target_mm = target * built.microstep_mm
        slip = self.faults.take("zaber.slip", kind)
        if slip:
            target_mm -= slip.value or 0.1
        if speed is not None and not 1 <= speed <= axis.max_speed:
            raise _RejectedError("BADDATA")
        ends_s = axis.motion.move_to(target_mm, axis.speed_mm_s(speed), now_s)
        self._schedule_faults(axis, now_s, ends_s, kind)
        self.disturbances.schedule([axis.motion], ends_s, f"move {kind}")

    def _schedule_faults(self, axis: _Axis, now_s: float, ends_s: float, about: str) -> None:
        """Schedule the faults of this move."""
        take, halfway_s = self.faults.take, (now_s + ends_s) / 2
        self._generation += 1
        if stall := take("zaber.stall", about):
            share = stall.value or 0.5
            self._schedule_end(now_s + share * (ends_s - now_s), [axis], "FS")
        if stall := take("zaber.recovers", about):
            self.disturbances.add(0.5, pause_s=stall.value or 0.05)
            self.clock.at(halfway_s, lambda: axis.flags.add("WS"))
        if take("zaber.limit", about):
            self._schedule_end(halfway_s, [axis], "FE", "WL")
        if take("zaber.emergency_stop", about):
            self._schedule_end(halfway_s, self._axes, "FH")
        if take("zaber.supply", about):
            self._schedule_end(halfway_s, self._axes, "FV", "FD")
        if take("zaber.pre_empted", about):
            self._schedule_end(halfway_s, [axis], "NC")
        if take("zaber.power_cycle", about):
            self.clock.at(halfway_s, self.power_cycle)
        if forever := take("zaber.never_idle", about):
            self._busy_until_s = ends_s + (forever.value or 3600.0)

    def _schedule_end(self, when_s: float, axes: Sequence[_Axis], *flags: str) -> None:
        generation = self._generation

        def end() -> None:
            if generation == self._generation:
                self._end_motion(axes, *flags)

        self.clock.at(when_s, end)

    def _end_motion(self, axes: Sequence[_Axis], *flags: str) -> None:
        for axis in axes:
            axis.flags |= set(flags)
            axis.motion.halt(self.clock.now_s())

    def _need_driver(self, number: int) -> None:
        if self.faults.take("zaber.driver_disabled"):
            for axis in self._chosen(number):
                axis.flags.add("FO")
        if any(axis.flags & {"FO", "FD", "FV"} for axis in self._chosen(number)):
            raise _RejectedError("DRIVERDISABLED")


def simulated(world: World, settings: Any) -> ZaberTwin:
    """Build the twin that a rig file's [stage] and [world] describe."""
    stated = world.stated
    start_mm = stated.start_mm(ZaberAxis.start_mm)
    axes = {
        axis: ZaberAxis(microstep_mm=microstep_mm, start_mm=start_mm, mechanics=stated.mechanics(axis))
        for axis, microstep_mm in settings.microstep_mm.items()
    }
    return ZaberTwin(world.clock, axes, stated.faults["stage"], address=settings.address)
