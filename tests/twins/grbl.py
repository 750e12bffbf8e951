"""GRBL controllers beyond the usual one: other firmware and compile-time options, startup lines, missing switches.

Facts, with their places:

- gnea/grbl (bfb67f0), report.c, report_build_info: letters of `[OPT:]`; `Z` is HOMING_FORCE_SET_ORIGIN, `H` are single
  axis homing commands, `+` is the safety door, `L` says that homing does not lock the controller at power-on.
- grblHAL core (f80fc34), report.c, report_init_message: "GrblHAL 1.1f ['$' or '$HELP' for help]"; `[FIRMWARE:grblHAL]`.
  protocol.c, protocol_main_loop: a start without homing raises ALARM:11 behind the greeting. protocol_exec_rt_system,
  protocol_poll_cmd: while the emergency stop is pressed, after ALARM:10, a reset has no effect and `?` is answered; so
  are the `$` lines that system.c allows, others with error:79, and what is no `$` line with error:9.
- bdring/FluidNC (c47d53c), SettingsDefinitions.cpp, make_settings: the greeting is the setting Start/Message, any text;
  make_proxies: `$$` has no `$1`, `$13`, and only the axes that are configured. Limit.cpp: the travel begins at the
  homing position `mpos_mm`. Channel.cpp (005572e), Channel::ack: with `verbose_errors` the words of Error.cpp's
  ErrorNames stand in place of an error's number. Protocol.cpp (e952f33f), protocol_do_start: a start without homing
  raises ALARM:14. ProcessSettings.cpp, home: $HX is refused with error:19 where allow_single_axis is false.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires import grbl
from gs2ci_sims.wires.grbl_build import AXES, GrblMachine, report_numbers
from gs2ci_sims.wires.serial_twin import SerialSession
from gs2ci_sims.world import VirtualClock


@dataclass(frozen=True)
class GrblBuild:
    """A firmware as compiled.

    Args:
        greeting: The line it prints when it has (re)started.
        version: Its line `[VER:...]`, without the brackets.
        options: Letters of `[OPT:]`.
        axes: How many axes it has.
        avr: Whether an AVR's timer makes the steps.
        unlisted: Settings that `$$` does not print.
        extra: Further lines of `$I`.
        homing_mm: Where an axis stands after homing, for firmware that has this as a setting of its own.
        words: What stands in place of an error's number.
        idle_ms: FluidNC's delay until the motors are switched off.
        unhomed: The alarm of a start without homing; 0 for none.
        alone: Whether an axis may be homed alone, where `$HX` is a command.
    """

    greeting: bytes = grbl.GrblTwin.greeting
    version: str = "1.1h.20190825:"
    options: str = "V"
    axes: int = 3
    avr: bool = True
    unlisted: frozenset[int] = frozenset()
    extra: tuple[str, ...] = ()
    homing_mm: Mapping[int, float] | None = None
    words: Mapping[int, str] = field(default_factory=dict)
    idle_ms: int = 255
    unhomed: int = 0
    alone: bool = True


GRBL = GrblBuild()


@dataclass
class OddMachine(GrblMachine):
    """A machine with firmware of any build.

    Args:
        build: Its firmware.
        startup: Its startup lines `$N0` and `$N1`.
        switches: Axes that have a reference switch.
        offset_mm: Work coordinate offset.
    """

    build: GrblBuild = field(default=GRBL)
    startup: tuple[str, str] = ("", "")
    switches: str = "xyz"
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


class GrblTwin(grbl.GrblTwin):
    """A GRBL controller of any build.

    Args:
        clock: The world's clock.
        machine: The machine.
        faults: The faults to inject.
        options: How the board is wired.
    """

    def __init__(
        self,
        clock: VirtualClock,
        machine: GrblMachine | None = None,
        faults: FaultSet | None = None,
        **options: Any,
    ) -> None:
        odd = machine if isinstance(machine, OddMachine) else OddMachine(**vars(machine) if machine else {})
        self._build, self._startup, self._switches = odd.build, odd.startup, odd.switches
        self.greeting, self._offset_mm = odd.build.greeting, odd.offset_mm
        super().__init__(clock, odd, faults, **options)
        del self._axes[odd.build.axes :]
        self._hangs_up = self._stopped = False

    def open(self, *, hangs_up: bool = False, lowers: bool = False) -> SerialSession:
        """Open the port.

        Args:
            hangs_up: Whether DTR falls when the session is closed (HUPCL, the default of a tty).
            lowers: Whether the program lowers DTR once the port is open.
        """
        session = super().open()
        self._hangs_up, self._dtr = hangs_up, not lowers
        return session

    def _answer(self, reply: str, about: str) -> None:
        kind, _, number = reply.partition(":")
        words = self._build.words.get(int(number)) if kind == "error" else None
        super()._answer(f"error:{words}" if words else reply, about)

    def press(self, button: Literal["hold", "resume", "reset"]) -> None:
        """Press a button at the controller."""
        self._realtime({"hold": ord("!"), "resume": ord("~"), "reset": 0x18}[button])

    def press_stop(self) -> None:
        """Press grblHAL's emergency stop."""
        self._forget()
        self._state, self._stopped = "Alarm", True
        for axis in self._axes:
            axis.halt(self.clock.now_s())
        self._reply(b"ALARM:10\r\n[MSG:Emergency stop]\r\n", "alarm")

    def release_stop(self) -> None:
        """Release it."""
        self._stopped = False

    def _soft_reset(self) -> None:
        if not self._stopped:
            super()._soft_reset()

    def _dollar(self, text: str) -> None:
        if self._stopped and text not in ("$$", "$G", "$I", "$N"):
            self._answer("error:79", text)
        else:
            super()._dollar(text)

    def _greet(self) -> None:
        super()._greet()
        if self._build.unhomed and self._state == "Alarm":
            self._reply(f"ALARM:{self._build.unhomed}\r\n".encode("ascii"), "alarm")

    def _closed(self) -> None:
        if self._hangs_up:
            self._dtr = False

    def _locks(self) -> bool:
        return super()._locks() and "L" not in self._build.options

    def _travel_mm(self, i: int) -> tuple[float, float]:
        length_mm, down = self._settings[130 + i], self._homes_down(i)
        if self._build.homing_mm is not None:
            home_mm = self._build.homing_mm[i]
            return (home_mm, home_mm + length_mm) if down else (home_mm - length_mm, home_mm)
        return (0.0, length_mm) if "Z" in self._build.options and down else super()._travel_mm(i)

    def _homed_mm(self, i: int) -> float:
        if self._build.homing_mm is not None:
            return self._build.homing_mm[i]
        return 0.0 if "Z" in self._build.options else super()._homed_mm(i)

    def _stepped_hz(self, rate_hz: float) -> float:
        return super()._stepped_hz(rate_hz) if self._build.avr else rate_hz

    def _cycles(self, text: str) -> Sequence[Sequence[int]] | None:
        if "H" in self._build.options and text[2:] in set("XYZ"[: len(self._axes)]):
            return (("XYZ".index(text[2:]),),)
        return super()._cycles(text)

    def _home(self, text: str) -> None:
        if text != "$H" and not self._build.alone:
            self._answer("error:19", text)
        else:
            super()._home(text)

    def _homing_cycle(self, cycles: list[list[int]], text: str, *, missing: bool) -> None:
        lost = any(AXES[i] not in self._switches for i in cycles[0])
        super()._homing_cycle(cycles, text, missing=missing or lost)

    def _listed(self) -> list[int]:
        shown = [n for n in super()._listed() if n < 100 or n % 10 < len(self._axes)]
        return [n for n in shown if n not in self._build.unlisted]

    def _built(self) -> list[str]:
        return [f"[VER:{self._build.version}]", f"[OPT:{self._build.options},15,128]", *self._build.extra]

    def _when_quiet(self, text: str) -> None:
        homing_mm = self._build.homing_mm
        if homing_mm is not None and (found := re.fullmatch(r"\$/AXES/([XYZ])/HOMING/MPOS_MM", text)):
            home_mm = homing_mm["XYZ".index(found[1])]
            self._answer(f"$/axes/{found[1].lower()}/homing/mpos_mm={home_mm:.3f}\r\nok", text)
        elif homing_mm is not None and text == "$/STEPPING/IDLE_MS":
            self._answer(f"$/stepping/idle_ms={self._build.idle_ms}\r\nok", text)
        else:
            super()._when_quiet(text)

    def _start_up(self) -> None:
        for line in filter(None, self._startup):
            self._reply(f">{line}:{self._gcode(line)}\r\n".encode("ascii"), "startup")

    def _positions(self, positions: list[float], offset: list[float]) -> str:
        if int(self._settings[10]) & 1:
            return super()._positions(positions, offset)
        work = [position - shift for position, shift in zip(positions, offset, strict=True)]
        return f"WPos:{report_numbers(work, self._settings)}"
