"""GRBL 1.1 lines: status reports, settings, greetings, alarms, errors. Pure; no port, no time.

Source: gnea/grbl doc/markdown/interface.md, settings.md, commands.md and doc/csv; reference section 3.3. grblHAL has
the state Tool, FluidNC the state Starting and only as many positions as axes are configured. From alarm 10 and error 18
on each family has numbers of its own: grblHAL/core f80fc34, alarms.h and errors.h; bdring/FluidNC e952f33f, Alarm.h and
Error.h.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite

LONGEST_LINE = 80
MOST_AXES = 8
"""grblHAL's; reports have a position of each."""
STATUS_REQUEST = b"?"
JOG_CANCEL = b"\x85"
FEED_HOLD = b"!"
SOFT_RESET = b"\x18"

ALARMS: dict[int, str] = {
    1: "hard limit hit; the position is lost",
    2: "target beyond the soft limits; the position is kept",
    3: "reset while moving; the position is lost",
    4: "probe not in its initial state",
    5: "probe made no contact",
    6: "homing: reset",
    7: "homing: safety door opened",
    8: "homing: pull-off did not clear the switch",
    9: "homing: switch not found",
    10: "GRBL: homing: dual axis switch not found; grblHAL: emergency stop; FluidNC: spindle",
    11: "grblHAL: homing required; FluidNC: an input pin was active at the start",
    12: "grblHAL: a limit switch is engaged; FluidNC: homing: it is not known which switch is engaged",
    13: "grblHAL: probe protection; FluidNC: stopped by a fault pin",
    14: "grblHAL: spindle; FluidNC: not homed since the start",
    15: "grblHAL: homing: second switch not found; FluidNC: not unlocked since the start",
    16: "grblHAL: self test failed; FluidNC: an expander restarted",
    17: "grblHAL: motor fault; FluidNC: error in a program",
    18: "grblHAL: homing: bad configuration; FluidNC: limit hit while probing",
    19: "grblHAL: Modbus",
    20: "grblHAL: no answer of an expander",
    21: "grblHAL: settings cannot be stored",
    22: "grblHAL: buffer overflow",
}
LOCKING_ALARMS = frozenset({1, 2})
"""After these the controller answers nothing until a soft reset (gnea/grbl, protocol.c, protocol_exec_rt_system).
grblHAL and FluidNC answer `?` after these and others (grblHAL: 10, 17, 20), and take no motion."""
ALARMS_OF_BEFORE = frozenset({1, 2, 3})
"""Alarms that homing does not raise: limits are not checked meanwhile (motion_control.c, mc_homing_cycle)."""
ERRORS: dict[int, str] = {
    1: "expected a command letter",
    2: "bad number format",
    3: "invalid $ statement",
    4: "negative value",
    5: "homing is disabled by $22",
    6: "step pulse too short",
    7: "EEPROM read failed, defaults restored",
    8: "only while idle",
    9: "locked out in alarm or jog state",
    10: "soft limits need homing",
    11: "line too long",
    12: "step rate too high",
    13: "safety door open",
    14: "line too long for EEPROM",
    15: "jog target beyond the machine's travel",
    16: "invalid jog command",
    17: "laser mode needs PWM",
    18: "grblHAL: reset is pressed; FluidNC: no axis has a homing cycle",
    19: "FluidNC: an axis that may not be homed alone",
    20: "unsupported or invalid command",
    21: "two commands of one modal group",
    22: "no feed rate",
    23: "needs an integer",
    33: "invalid motion target",
    40: "grblHAL: a tool change waits; FluidNC: an input pin is active",
    45: "grblHAL: a limit switch is engaged",
    46: "grblHAL: not before it is homed",
    50: "grblHAL: emergency stop",
    51: "grblHAL: motor fault",
    79: "grblHAL: not before a reset, after an emergency stop, a motor fault or a limit",
    130: "FluidNC: the jog was cancelled",
    152: "FluidNC: its configuration has errors",
}
_SAID = {
    "Command requires idle state": 8,
    "GCode cannot be executed in lock or alarm state": 9,
    "Max travel exceeded during jog": 15,
    "Single axis homing not allowed": 19,
}
"""Errors whose numbers decide what is done next, as FluidNC words them where its configuration has `verbose_errors`."""
MOVING_STATES = frozenset({"Run", "Jog", "Home"})
SUSPENDED_STATES = frozenset({"Hold", "Door", "Sleep"})
"""In these no line is read: what is sent waits, and is executed when somebody resumes."""
STATES = frozenset({"Idle", "Alarm", "Check", "Tool", "Starting"}) | MOVING_STATES | SUSPENDED_STATES

_BANNER = re.compile(r"^Grbl(HAL)? \d+\.\d+\w*\b.*\[", re.IGNORECASE)
_KNOWN = re.compile(r"^(?:<|\[|\$|>|ok$|error:|ALARM:\d)")
_WORDS = re.compile(r"^[\x20-\x7e]*[A-Za-z]{3}[\x20-\x7e]*$")
_STARTUP = re.compile(r"^\$(N\d)=(.*)$")
_ITEM = re.compile(r"^\$?/([\w/]+)=(-?\d+(?:\.\d+)?)$")
_SETTING = re.compile(r"^\$(\d{1,3})=(-?\d+(?:\.\d+)?)$")
_CODE = re.compile(r"^(error|ALARM):(\d{1,3})$")


@dataclass(frozen=True)
class Status:
    """A status report `<...>`.

    Args:
        state: Machine state without its sub-state.
        substate: Number after the colon, or None.
        machine: Machine position as reported (mm or inches), or None if only the work position was reported.
        work: Work position, or None.
        offset: Work coordinate offset, present in some reports only.
        pins: Letters of triggered input pins.
        fields: All fields by name.
    """

    state: str
    substate: int | None
    machine: tuple[float, ...] | None
    work: tuple[float, ...] | None
    offset: tuple[float, ...] | None
    pins: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)

    @property
    def moving(self) -> bool:
        """Get whether the machine moves, or brakes."""
        braking = (self.state == "Hold" and self.substate == 1) or (self.state == "Door" and self.substate in (2, 3, 4))
        return self.state in MOVING_STATES or braking

    @property
    def suspended(self) -> bool:
        """Get whether no line is read."""
        return self.state in SUSPENDED_STATES


def parse_status(line: str) -> Status:
    """Read a status report.

    Raises:
        ValueError: Not a status report, or one without a position.
    """
    if not (line.startswith("<") and line.endswith(">")):
        raise ValueError("a status report stands in < >")
    head, *parts = line[1:-1].split("|")
    state, _, sub = head.partition(":")
    if state not in STATES or (sub and not sub.isdigit()):
        raise ValueError(f"unknown state {head!r}")
    fields = dict(part.partition(":")[::2] for part in parts)
    machine, work = _numbers(fields.get("MPos")), _numbers(fields.get("WPos"))
    if machine is None and work is None:
        raise ValueError("no MPos and no WPos")
    return Status(
        state=state,
        substate=int(sub) if sub else None,
        machine=machine,
        work=work,
        offset=_numbers(fields.get("WCO")),
        pins=fields.get("Pn", ""),
        fields=fields,
    )


def _numbers(text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    values = tuple(float(part) for part in text.split(","))
    if not 1 <= len(values) <= MOST_AXES or not all(isfinite(value) for value in values):
        raise ValueError(f"not a position: {text!r}")
    return values


def parse_setting(line: str) -> tuple[int, float] | None:
    """Return number and value of a `$n=v` line, or None."""
    match = _SETTING.match(line)
    return (int(match[1]), float(match[2])) if match else None


def parse_code(line: str) -> tuple[str, int] | None:
    """Return ("error" or "ALARM", its number), or None; 0 for an error in words that are not known here."""
    match = _CODE.match(line)
    if line.startswith("error:") and not match:
        return "error", _SAID.get(line.removeprefix("error:"), 0)
    return (match[1], int(match[2])) if match else None


def parse_startup(line: str) -> tuple[str, str] | None:
    """Return name and text of a startup line `$N0=...`, or None."""
    match = _STARTUP.match(line)
    return (match[1], match[2]) if match else None


def parse_item(line: str, path: str) -> float | None:
    """Return a number of FluidNC's configuration, "stepping/idle_ms", or None if the line is another one."""
    match = _ITEM.match(line)
    return float(match[2]) if match and match[1].lower() == path else None


def is_banner(line: str) -> bool:
    """Return whether this is a greeting: the controller has just (re)started."""
    return _BANNER.match(line) is not None


def is_strange(line: str) -> bool:
    """Return whether this is text that no GRBL prints in answer to anything: perhaps a greeting of the user's own."""
    return _KNOWN.match(line) is None and _WORDS.match(line) is not None


def jog(targets_mm: Mapping[str, float], feed_mm_min: float) -> str:
    """Build a jog in machine coordinates, millimetres, absolute; it does not change the parser's modes.

    Raises:
        ValueError: Longer than a controller accepts.
    """
    words = " ".join(f"{axis.upper()}{position:.4f}" for axis, position in targets_mm.items())
    line = f"$J=G53 G21 G90 {words} F{feed_mm_min:.7g}"
    if len(line) + 1 > LONGEST_LINE:
        raise ValueError(f"{len(line)} characters; a controller takes at most {LONGEST_LINE}")
    return line
