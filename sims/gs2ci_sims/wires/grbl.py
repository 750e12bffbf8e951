"""The twin of a GRBL 1.1 controller with three axes: real-time bytes, line replies, jogs, homing, alarms.

It parses lines with its own code. States, early Idle, reboot and locking are as in reference 3.3. Alarms and soft
resets are those of GRBL 1.1h (gnea/grbl bfb67f0):

- report.c, report_alarm_message: it halts for half a second after ALARM:n and does nothing meanwhile;
- protocol.c, protocol_exec_rt_system: after ALARM:1 and 2 it answers nothing, `?` included, until a soft reset, and a
  reset within that half second has no effect;
- motion_control.c, mc_reset: a reset in motion kills the steppers, ALARM:3 or, in a homing cycle, ALARM:6;
- limits.c, limits_go_home: a homing cycle answers no `?` and ends early by a reset only; when it has failed, system.c's
  `ok` follows the alarm, and then the restart (gnea/grbl issue 1067 shows the lines);
- main.c and protocol_main_loop: a restart empties the serial buffer and clears a pending `?`; the state Alarm outlives
  a soft reset, whatever $22 is.

The motors run in open loop: if an axis is blocked the controller continues to count, and only the carriage stands
still. Not here: the byte level (`serial_twin`), the driver.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import hypot
from typing import Any, Literal

from gs2ci_sims.axis_motion import AxisMotion, Mechanics
from gs2ci_sims.faults import FaultSet, declare
from gs2ci_sims.wires.serial_twin import REPLY_LATENCY_S, SerialSession, SerialTwin
from gs2ci_sims.world import VirtualClock, World

HARD_LIMIT = declare("grbl.hard_limit", "a limit switch trips after half of the next move: ALARM:1")
RESET_MOVING = declare("grbl.reset_moving", "the controller resets itself after half of the next move: ALARM:3")
POWER_CYCLE = declare("grbl.power_cycle", "the controller reboots after half of the next move: banner, position 0")
EARLY_IDLE = declare("grbl.early_idle", "the first reports after a move state Idle although it still moves")
DOOR = declare("grbl.door", "the safety door opens after half of the next move")
HOLD = declare("grbl.hold", "somebody presses feed hold after half of the next move")
JOG_CANCELLED = declare("grbl.jog_cancelled", "somebody cancels the next jog half-way")
ERROR = declare("grbl.error", "a line is answered with error:`value` (0: 20)")
HOMING_FAILS = declare("grbl.homing_fails", "homing does not find the switch: ALARM:9")
BANNER_INSIDE = declare("grbl.banner_inside", "a spurious banner in the middle of a reply's line")
MESSAGE = declare("grbl.message", "a [MSG:...] line comes before a reply")
SILENT_STATUS = declare("grbl.silent_status", "a status request is not answered")

BOOT_S = 1.2
BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
ALARM_PAUSE_S = 0.5
CRITICAL_ALARMS = (1, 2)
DWELL_S = 0.01
AXES = ("x", "y", "z")
_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d*)?|-?\.\d+)")


@dataclass
class GrblMachine:
    """A machine as built and set up.

    Args:
        settings: Values of `$n`, on top of the defaults.
        start_mm: Machine position at power-on.
        homed: Whether it has been homed before (otherwise it is locked in Alarm if homing is enabled).
        mechanics: For each axis the errors between counted and true position.
    """

    settings: Mapping[int, float] = field(default_factory=dict)
    start_mm: tuple[float, float, float] = (-100.0, -100.0, -10.0)
    homed: bool = True
    mechanics: Mapping[str, Mechanics] = field(default_factory=dict)


DEFAULTS: dict[int, float] = {
    10: 1, 13: 0, 20: 1, 21: 1, 22: 1, 23: 0, 24: 25, 25: 500, 26: 250, 27: 1,
    100: 320, 101: 320, 102: 320, 110: 1800, 111: 1800, 112: 600,
    120: 200, 121: 200, 122: 100, 130: 200, 131: 200, 132: 60,
}  # fmt: skip


class GrblTwin(SerialTwin):
    """A GRBL controller with its machine.

    Args:
        clock: The world's clock.
        machine: The machine.
        faults: The faults to inject.
        board: "uno": a rising DTR resets it (the 100 nF between the USB chip's DTR and RESET in the Uno's schematic);
            "native": USB of its own, which answers only while DTR is high (an RP2040's CDC); "plain": DTR is not wired.
    """

    def __init__(
        self,
        clock: VirtualClock,
        machine: GrblMachine | None = None,
        faults: FaultSet | None = None,
        *,
        board: Literal["plain", "uno", "native"] = "plain",
    ) -> None:
        super().__init__(clock, faults)
        machine = machine or GrblMachine()
        self._board = board
        self._dtr = self._hangs_up = False
        self._settings = DEFAULTS | dict(machine.settings)
        self._axes = [
            AxisMotion(machine.start_mm[i], self._settings[120 + i], machine.mechanics.get(name))
            for i, name in enumerate(AXES)
        ]
        self._state = "Idle" if machine.homed or not self._settings[22] else "Alarm"
        self._deaf_until_s = 0.0
        self._awaits_reset = False
        self._generation = 0
        self._early_reports = 0

    @property
    def terminators(self) -> bytes:
        """Get line feed and carriage return."""
        return b"\r\n"

    def open(self, *, hangs_up: bool = False, lowers: bool = False) -> SerialSession:
        """Open the port: Linux raises DTR, which resets an Uno if DTR was low.

        Args:
            hangs_up: Whether DTR falls when the session is closed (HUPCL, the default of a tty).
            lowers: Whether the program lowers DTR once the port is open.
        """
        session = super().open()
        rises, self._dtr, self._hangs_up = not self._dtr, True, hangs_up
        if rises and self._board == "uno":
            self.reboot()
        self._dtr = not lowers
        return session

    def unplug(self) -> None:
        """Unplug the device: the USB chip loses its lines."""
        super().unplug()
        self._dtr = False

    def _closed(self) -> None:
        if self._hangs_up:
            self._dtr = False

    def _reply(self, data: bytes, about: str = "", delay_s: float = REPLY_LATENCY_S) -> None:
        if self._board != "native" or self._dtr:
            super()._reply(data, about, delay_s)

    def positions_mm_at(self, when_s: float) -> dict[str, float]:
        """Return the true positions of the carriages."""
        return {name: axis.true_position_at(when_s) for name, axis in zip(AXES, self._axes, strict=True)}

    def reboot(self) -> None:
        """Restart: motion ends, the position counts from 0, and the machine is locked if homing is enabled."""
        now_s = self.clock.now_s()
        self._generation += 1
        self._incoming = b""
        for axis in self._axes:
            axis.halt(now_s)
            axis.set_position(0.0, now_s)
        self._state = "Alarm" if self._settings[22] else "Idle"
        self._awaits_reset = False
        self._deaf_until_s = now_s + BOOT_S
        self._reply(self._greeting(), "banner", BOOT_S)

    def _stale(self) -> bytes:
        return b"ok\r\n<Run|MPos:1.000,2.000,3.000|FS:500,0>\r\n"

    def _realtime(self, byte: int) -> bool:
        if self.clock.now_s() < self._deaf_until_s:
            return True  # the boot loader, and the restart after an alarm, discard what was received
        if byte == 0x18:
            self._soft_reset()
        elif self._awaits_reset:
            return True
        elif byte == ord("?"):
            if self._state != "Home" and not self.faults.take(SILENT_STATUS):
                self._reply(self._report(), "?")
        elif byte == 0x85:
            if self._state == "Jog":
                self._brake("Idle")
        elif byte == ord("!"):
            if self._state in ("Jog", "Run"):
                self._brake("Hold")
        elif byte == ord("~"):
            if self._state == "Hold":
                self._state = "Idle"
        elif not 0x80 <= byte <= 0xA1:
            return False
        return True

    def _report(self) -> bytes:
        now_s = self.clock.now_s()
        positions = [axis.position_at(now_s) for axis in self._axes]
        unit = 1 / 25.4 if self._settings[13] else 1.0
        shown = ",".join(f"{position * unit:.3f}" for position in positions)
        state = self._state
        if state == "Jog" and self._early_reports:
            self._early_reports -= 1
            state = "Idle"
        state = {"Hold": "Hold:0", "Door": "Door:0"}.get(state, state)
        speed = hypot(*(axis.speed_at(now_s) for axis in self._axes)) * 60
        return f"<{state}|MPos:{shown}|FS:{speed:.0f},0>\r\n".encode("ascii")

    def _soft_reset(self) -> None:
        if self._state == "Home":
            self._alarm(6)
        elif self._moving():
            self._alarm(3)
        else:
            self._generation += 1
            self._incoming = b""
            self._awaits_reset = False
            self._state = "Alarm" if self._state == "Alarm" else "Idle"
            self._reply(self._greeting(), "banner")

    def _greeting(self) -> bytes:
        return BANNER + (b"[MSG:'$H'|'$X' to unlock]\r\n" if self._state == "Alarm" else b"")

    def _line(self, line: bytes) -> None:
        if self.clock.now_s() < self._deaf_until_s or self._awaits_reset:
            return
        text = line.decode("ascii", "replace").upper().replace(" ", "")
        if self.faults.take(MESSAGE, text):
            self._reply(b"[MSG:Check Limits]\r\n", text)
        if error := self.faults.take(ERROR, text):
            self._answer(f"error:{error.value or 20:.0f}", text)
        elif len(line) > 80:
            self._answer("error:11", text)
        elif text.startswith("$"):
            self._dollar(text)
        else:
            self._gcode(text)

    def _answer(self, reply: str, about: str) -> None:
        data = reply.encode("ascii") + b"\r\n"
        if self.faults.take(BANNER_INSIDE, about):
            data = data[: len(data) // 2] + b"\r\n" + BANNER + data[len(data) // 2 :]
        self._reply(data, about)

    def _dollar(self, text: str) -> None:
        if text == "$$":
            rows = "".join(f"${number}={value:g}\r\n" for number, value in sorted(self._settings.items()))
            self._answer(rows + "ok", text)
        elif text == "$I":
            self._answer("[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok", text)
        elif text == "$X":
            self._state = "Idle" if self._state == "Alarm" else self._state
            self._answer("ok", text)
        elif text == "$H":
            self._home()
        elif text.startswith("$J="):
            self._answer(self._jog(text.removeprefix("$J=")), text)
        else:
            self._answer("error:3", text)

    def _gcode(self, text: str) -> None:
        if self._state in ("Alarm", "Jog"):
            self._answer("error:9", text)
        elif text.startswith("G4P"):
            end_s = max([self.clock.now_s(), *(axis.ends_s for axis in self._axes)])
            self._state = "Run"
            generation = self._generation

            def done() -> None:
                if generation == self._generation:
                    self._state = "Idle"
                    self._answer("ok", text)

            self.clock.at(end_s + DWELL_S, done)
        elif not text or text in ("G21", "G90", "G94", "G21G90G94"):
            self._answer("ok", text)
        else:
            self._answer("error:20", text)

    def _jog(self, text: str) -> str:
        if self._state not in ("Idle", "Jog"):
            return "error:9" if self._state == "Alarm" else "error:8"
        words = _WORD.findall(text)
        if "".join(letter + number for letter, number in words) != text:
            return "error:2"
        modes = {letter + number for letter, number in words if letter == "G"}
        if modes - {"G53", "G21", "G90"}:
            return "error:16"
        values = {letter: float(number) for letter, number in words if letter != "G"}
        feed = values.pop("F", 0.0)
        if feed <= 0:
            return "error:22"
        if not values or set(values) - {"X", "Y", "Z"}:
            return "error:16"
        targets = {"XYZ".index(letter): value for letter, value in values.items()}
        if self._settings[20] and any(not -self._settings[130 + i] <= target <= 0 for i, target in targets.items()):
            return "error:15"
        self._begin_jog(targets, feed / 60.0)
        return "ok"

    def _begin_jog(self, targets: Mapping[int, float], path_mm_s: float) -> None:
        now_s = self.clock.now_s()
        distances = {i: target - self._axes[i].position_at(now_s) for i, target in targets.items()}
        path = hypot(*distances.values())
        ends_s = now_s
        for i, distance in distances.items():
            step = 1.0 / self._settings[100 + i]
            speed = min(path_mm_s * abs(distance) / path if path else path_mm_s, self._settings[110 + i] / 60)
            target = round(targets[i] / step) * step
            if speed > 0:
                ends_s = max(ends_s, self._axes[i].move_to(target, speed, now_s))
        self._state = "Jog"
        self._generation += 1
        self._later(ends_s, self._rest)
        if self.faults.take(EARLY_IDLE):
            self._early_reports = 2
        halfway_s = (now_s + ends_s) / 2
        for kind, action in (
            (HARD_LIMIT, lambda: self._alarm(1)),
            (RESET_MOVING, self._soft_reset),
            (POWER_CYCLE, self.reboot),
            (DOOR, lambda: self._brake("Door")),
            (HOLD, lambda: self._brake("Hold")),
            (JOG_CANCELLED, lambda: self._brake("Idle")),
        ):
            if self.faults.take(kind):
                self._later(halfway_s, action)

    def _home(self) -> None:
        if not self._settings[22]:
            self._answer("error:5", "$H")
            return
        now_s = self.clock.now_s()
        self._state = "Home"
        self._generation += 1
        seek_mm_s = self._settings[25] / 60
        ends_s = max(axis.move_to(0.0, seek_mm_s, now_s) for axis in self._axes)
        fails = self.faults.take(HOMING_FAILS) is not None

        def done() -> None:
            if fails:
                self._alarm(9)
                return
            for axis in self._axes:
                axis.set_position(-self._settings[27], self.clock.now_s())
            self._state = "Idle"
            self._answer("ok", "$H")

        self._later(ends_s + 0.5, done)

    def _later(self, when_s: float, action: Callable[[], None]) -> None:
        """Schedule an action that a newer motion, a stop or a reset cancels."""
        generation = self._generation

        def act() -> None:
            if generation == self._generation:
                action()

        self.clock.at(when_s, act)

    def _rest(self) -> None:
        self._state = "Idle"

    def _brake(self, state: str) -> None:
        now_s = self.clock.now_s()
        self._generation += 1
        ends_s = max(axis.stop(now_s) for axis in self._axes)

        def rest() -> None:
            self._state = state

        self._later(ends_s, rest)

    def _alarm(self, number: int) -> None:
        now_s = self.clock.now_s()
        homing, self._state = self._state == "Home", "Alarm"
        self._generation += 1
        self._incoming = b""
        for axis in self._axes:
            axis.halt(now_s)
        self._reply(f"ALARM:{number}\r\n".encode("ascii"), "alarm")
        self._deaf_until_s = now_s + ALARM_PAUSE_S
        self._awaits_reset = number in CRITICAL_ALARMS
        if self._awaits_reset:
            after, about = b"[MSG:Reset to continue]\r\n", "alarm"
        else:
            after, about = (b"ok\r\n" if homing else b"") + self._greeting(), "banner"
        self._later(self._deaf_until_s, lambda: self._reply(after, about))

    def _moving(self) -> bool:
        return any(axis.moving_at(self.clock.now_s()) for axis in self._axes)


def simulated(world: World, settings: Any) -> GrblTwin:
    """Build the twin that a rig file's [stage] and [world] describe; the controller has three axes in any case."""
    stated, built = world.stated, GrblMachine()
    x_mm, y_mm, z_mm = built.start_mm
    machine = GrblMachine(
        start_mm=(stated.start_mm(x_mm), stated.start_mm(y_mm), z_mm),
        mechanics={axis: stated.mechanics(axis) for axis in AXES},
    )
    return GrblTwin(world.clock, machine, stated.faults["stage"], board=stated.table.grbl_board)
