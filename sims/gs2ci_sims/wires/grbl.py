"""The twin of a GRBL controller: real-time bytes, line replies, jogs, programs, homing, holds, doors, alarms, restarts.

It parses lines with its own code. What it does is GRBL 1.1h's (gnea/grbl bfb67f0):

- serial.c: real-time bytes are taken out of turn; 0x85 is dropped unless the state is Jog already;
- protocol.c, protocol_main_loop and protocol_exec_rt_suspend: lines are executed one after another, in their time; in
  Hold, Door and Sleep none is read, and none is answered: they wait in the buffer of 128 bytes;
- protocol.c, protocol_exec_rt_system: any hold in a jog cancels it and ends in Idle (a door in Door); after ALARM:1 and
  2 nothing is answered, `?` included, until a soft reset, and a reset within half a second of it has no effect;
- system.c, system_execute_line: `$J=` only in Idle and Jog, `$$` not in Run and Hold, `$I`, `$N`, `$H` only in Idle
  and Alarm, else error:8; system_check_travel_limits checks every axis, named or not;
- motion_control.c, mc_reset: a reset in motion kills the steppers (ALARM:3, in a homing cycle ALARM:6) and stops the
  processor for `$1` ms (stepper.c, st_go_idle), before report.c, report_alarm_message, halts it for half a second; a
  reset at rest keeps the position, and main.c then executes the startup lines;
- limits.c, limits_go_home and config.h: homing takes z, then x and y together, fast and then slowly; it answers no `?`
  and ends early by a reset only; when it has failed, system.c's `ok` follows the alarm, and then the restart;
- report.c, report_realtime_status: `$10=0` reports work positions, and their offset in the first report and then in
  each 10th (30th in motion).

The motors run in open loop: if an axis is blocked the controller continues to count, and only the carriage stands
still; a restart begins to count from 0 where the carriage stands. Not here: the byte level (`serial_twin`), the
machine and its arithmetic (`grbl_build`), the driver.
"""

import re
from collections.abc import Mapping
from math import ceil, hypot
from typing import Any, Literal

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.grbl_build import AXES, GrblMachine, report_numbers
from gs2ci_sims.wires.grbl_core import MOVING, SUSPENDED, GrblCore
from gs2ci_sims.wires.serial_twin import REPLY_LATENCY_S, SerialSession
from gs2ci_sims.world import VirtualClock, World

BOOT_S = 1.2
RX_BYTES = 128
LINE_S = 2e-3
"""Reading, parsing and planning a line on an AVR: a jog begins some ms after its last byte (run on the firmware)."""
DWELL_STEP_S = 0.05
"""A dwell takes whole steps of DWELL_TIME_STEP (nuts_bolts.c, delay_sec), in the state Idle."""
REFRESH = {True: 29, False: 9}
_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d*)?|-?\.\d+)")
_SET = re.compile(r"\$(\d{1,3})=(-?\d+(?:\.\d*)?)$")


class GrblTwin(GrblCore):
    """A GRBL controller with its machine.

    Args:
        clock: The world's clock.
        machine: The machine.
        faults: The faults to inject.
        board: "uno": a rising DTR resets it (the 100 nF between the USB chip's DTR and RESET in the Uno's schematic);
            "native": USB of its own, which answers only while DTR is high (an RP2040's CDC); "plain": DTR is not wired.
    """

    greeting = b"Grbl 1.1h ['$' for help]"
    _startup = ("", "")
    _offset_mm = (0.0, 0.0, 0.0)

    def __init__(
        self,
        clock: VirtualClock,
        machine: GrblMachine | None = None,
        faults: FaultSet | None = None,
        *,
        board: Literal["plain", "uno", "native"] = "plain",
    ) -> None:
        super().__init__(clock, machine or GrblMachine(), faults)
        self._board = board
        self._dtr = False
        self._waiting: list[bytes] = []
        self._executing = False
        self._reports = 0

    @property
    def terminators(self) -> bytes:
        """Get line feed and carriage return."""
        return b"\r\n"

    def open(self) -> SerialSession:
        """Open the port: Linux raises DTR, which resets an Uno if DTR was low."""
        session = super().open()
        rises, self._dtr = not self._dtr, True
        if rises and self._board == "uno":
            self.reboot()
        return session

    def unplug(self) -> None:
        """Unplug the device: the USB chip loses its lines."""
        super().unplug()
        self._dtr = False

    def reboot(self) -> None:
        """Restart: motion ends, the position counts from 0, and the machine is locked if homing is enabled."""
        now_s = self.clock.now_s()
        for axis in self._axes:
            axis.halt(now_s)
            axis.set_position(0.0, now_s)
        self._forget()
        self._state = "Alarm" if self._locks() else "Idle"
        self._deaf_until_s = now_s + BOOT_S
        self._in_this_life(BOOT_S, self._greet)

    def run_program(self, line: str) -> None:
        """Receive a line of another program's."""
        self._line(line.encode("ascii"))

    def _reply(self, data: bytes, about: str = "", delay_s: float = REPLY_LATENCY_S) -> None:
        if self._board != "native" or self._dtr:
            super()._reply(data, about, delay_s)

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
            if self._state != "Home" and not self.faults.take("grbl.silent_status"):
                self._reply(self._report(), "?")
        elif byte == 0x85:
            if self._state == "Jog":
                self._cancel("Idle")
        elif byte in (ord("!"), 0x84):
            self._suspend("Hold" if byte == ord("!") else "Door")
        elif byte == ord("~"):
            self._resume()
        elif not 0x80 <= byte <= 0xA1:
            return False
        return True

    def _report(self) -> bytes:
        now_s, state = self.clock.now_s(), self._state
        positions = [axis.position_at(now_s) for axis in self._axes]
        if state == "Jog" and self._early_reports:
            self._early_reports -= 1
            state = "Idle"
        sub = {"Hold": int(self._moving()), "Door": 2 if self._moving() else int(self._ajar)}.get(state)
        fields = [state if sub is None else f"{state}:{sub}"]
        offset = list(self._offset_mm[: len(self._axes)])
        fields.append(self._positions(positions, offset))
        fields.append(f"FS:{hypot(*(axis.speed_at(now_s) for axis in self._axes)) * 60:.0f},0")
        if self._ajar:
            fields.append("Pn:D")
        if self._reports == 0:
            fields.append(f"WCO:{report_numbers(offset, self._settings)}")
            self._reports = REFRESH[state in MOVING]
        else:
            self._reports -= 1
        return f"<{'|'.join(fields)}>\r\n".encode("ascii")

    def _positions(self, positions: list[float], offset: list[float]) -> str:
        return f"MPos:{report_numbers(positions, self._settings)}"

    def _forget(self) -> None:
        """Begin anew, as main.c does: nothing that was received or planned before is done."""
        self._generation += 1
        self._life += 1
        self._incoming = b""
        self._waiting.clear()
        self._blocks.clear()
        self._present, self._executing, self._awaits_reset, self._reports = None, False, False, 0

    def _greet(self) -> None:
        lock = b"[MSG:'$H'|'$X' to unlock]\r\n" if self._state == "Alarm" else b""
        self._reply(b"\r\n" + self.greeting + b"\r\n" + lock, "banner")
        if self._state == "Idle":
            self._start_up()

    def _line(self, line: bytes) -> None:
        if self.clock.now_s() < self._deaf_until_s or self._awaits_reset:
            return
        if sum(len(waiting) + 1 for waiting in self._waiting) + len(line) < RX_BYTES:
            self._waiting.append(line)
        self._pump()

    def _pump(self) -> None:
        """Read the next line, unless one is being executed or nothing is read at all."""
        if self._executing or not self._waiting or self._state in SUSPENDED:
            return
        line, self._executing = self._waiting.pop(0), True
        self._in_this_life(LINE_S, lambda: self._execute(line))

    def _execute(self, line: bytes) -> None:
        text = line.decode("ascii", "replace").upper().replace(" ", "")
        if text.startswith("$J=") and self.faults.take("grbl.held", text):
            self._suspend("Hold")
        if self._state in SUSPENDED:  # it was suspended meanwhile (protocol_execute_realtime before each line)
            self._waiting.insert(0, line)
            self._executing = False
            return
        if self.faults.take("grbl.message", text):
            self._reply(b"[MSG:Check Limits]\r\n", text)
        if error := self.faults.take("grbl.error", text):
            self._answer(f"error:{error.value or 20:.0f}", text)
        elif len(line) > 80:
            self._answer("error:11", text)
        elif text.startswith("$"):
            self._dollar(text)
        elif text.startswith("G4P") and self._state not in ("Alarm", "Jog"):
            self._dwell(text)
        elif self._state in ("Alarm", "Jog") and text:
            self._answer("error:9", text)
        else:
            self._answer(self._gcode(text), text)

    def _answer(self, reply: str, about: str) -> None:
        """End a line with its reply, and read the next one."""
        data = reply.encode("ascii") + b"\r\n"
        if self.faults.take("grbl.banner_inside", about):
            data = data[: len(data) // 2] + b"\r\n" + self.greeting + b"\r\n" + data[len(data) // 2 :]
        self._reply(data, about)
        self._executing = False
        self._pump()

    def _dollar(self, text: str) -> None:
        quiet = self._state in ("Idle", "Alarm")
        if text == "$":
            self._answer("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\nok", text)
        elif text == "$$":
            rows = "".join(f"${number}={self._settings[number]:g}\r\n" for number in self._listed())
            self._answer("error:8" if self._state in ("Run", "Hold") else rows + "ok", text)
        elif text == "$G":
            self._answer("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok", text)
        elif text.startswith("$J="):
            self._answer(self._jog(text.removeprefix("$J=")), text)
        elif text == "$X":
            self._state = "Idle" if self._state == "Alarm" else self._state
            self._answer("ok", text)
        elif text == "$C":
            self._check()
        elif not quiet:
            self._answer("error:8", text)
        else:
            self._when_quiet(text)

    def _when_quiet(self, text: str) -> None:
        """Answer what is answered only in Idle and Alarm."""
        if text == "$I":
            self._answer("\r\n".join([*self._built(), "ok"]), text)
        elif text == "$N":
            self._answer("".join(f"$N{i}={line}\r\n" for i, line in enumerate(self._startup)) + "ok", text)
        elif text == "$SLP":
            self._state = "Sleep"
            self._answer("ok", text)
        elif text.startswith("$H"):
            self._home(text)
        elif found := _SET.fullmatch(text):
            self._settings[int(found[1])] = float(found[2])
            self._answer("ok", text)
        else:
            self._answer("error:3", text)

    def _listed(self) -> list[int]:
        return sorted(self._settings)

    def _built(self) -> list[str]:
        return ["[VER:1.1h.20190825:]", "[OPT:V,15,128]"]

    def _check(self) -> None:
        if self._state == "Check":
            self._answer("[MSG:Disabled]\r\nok", "$C")
            self._soft_reset()
        elif self._state == "Idle":
            self._state = "Check"
            self._answer("[MSG:Enabled]\r\nok", "$C")
        else:
            self._answer("error:8", "$C")

    def _dwell(self, text: str) -> None:
        """Wait for all motions and then for the dwell; delay_sec leaves the state as it is (nuts_bolts.c)."""
        seconds = float(text.removeprefix("G4P"))

        def dwelt() -> None:
            if self._state in (*MOVING, *SUSPENDED) or self._moving():
                self._in_this_life(LINE_S, dwelt)
            else:
                self._in_this_life(
                    max(ceil(seconds / DWELL_STEP_S), 1) * DWELL_STEP_S, lambda: self._answer("ok", text)
                )

        dwelt()

    def _gcode(self, text: str) -> str:
        words = _words(text)
        if words is None:
            return "error:1"
        modes, values, feed = words
        if modes - {"G0", "G1", "G21", "G53", "G90", "G94"} or set(values) - {"X", "Y", "Z"}:
            return "error:20"
        if values and self._state != "Check":
            if not modes & {"G0", "G1"} or not (feed or "G0" in modes):
                return "error:22"
            self._plan(values, (feed or 1e9) / 60, "Run")
        return "ok"

    def _jog(self, text: str) -> str:
        if self._state not in ("Idle", "Jog"):
            return "error:8"
        words = _words(text)
        if words is None:
            return "error:2"
        modes, values, feed = words
        if modes - {"G53", "G21", "G90"}:
            return "error:16"
        if feed <= 0:
            return "error:22"
        if not values or set(values) - {letter.upper() for letter in AXES[: len(self._axes)]}:
            return "error:16"
        if self._settings[20] and not self._inside(values):
            return "error:15"
        self._plan(values, feed / 60.0, "Jog")
        return "ok"

    def _inside(self, values: Mapping[str, float]) -> bool:
        """Check the target of every axis; one that is not named stays where it is."""
        now_s = self.clock.now_s()
        for i, axis in enumerate(self._axes):
            low_mm, high_mm = self._travel_mm(i)
            if not low_mm <= values.get(AXES[i].upper(), axis.position_at(now_s)) <= high_mm:
                return False
        return True


def _words(text: str) -> tuple[set[str], dict[str, float], float] | None:
    """Return a line's modes, the values of its other letters, and its feed; None for what are no words."""
    words = _WORD.findall(text)
    if "".join(letter + number for letter, number in words) != text:
        return None
    values = {letter: float(number) for letter, number in words if letter != "G"}
    feed = values.pop("F", 0.0)
    return {letter + number for letter, number in words if letter == "G"}, values, feed


def simulated(world: World, settings: Any) -> GrblTwin:
    """Build the twin that a rig file's [stage] and [world] describe; the controller has three axes in any case."""
    stated, built = world.stated, GrblMachine()
    x_mm, y_mm, z_mm = built.start_mm
    machine = GrblMachine(
        start_mm=(stated.start_mm(x_mm), stated.start_mm(y_mm), z_mm),
        mechanics={axis: stated.mechanics(axis) for axis in AXES},
    )
    return GrblTwin(world.clock, machine, stated.faults["stage"], board=stated.table.grbl_board)
