"""What Zaber's warning flags and rejections mean. Pure tables.

F flags are faults (the motor driver is disabled or the motion was stopped), W are warnings, N are notes. Source: Zaber
ASCII protocol manual, "Warning flags" and "Reply"; reference section 3.1.
"""

FLAGS: dict[str, str] = {
    "FF": "critical system error",
    "FN": "peripheral not supported",
    "FZ": "peripheral inactive",
    "FH": "emergency stop",
    "FV": "supply voltage out of range, driver disabled",
    "FC": "inrush current, driver disabled",
    "FM": "motor temperature, driver disabled",
    "FD": "driver disabled on a fault",
    "FO": "driver disabled",
    "FQ": "encoder error",
    "FI": "index error",
    "FA": "analogue encoder out of sync",
    "FR": "overdrive limit exceeded",
    "FB": "stream bounds exceeded",
    "FP": "interpolated path deviation",
    "FT": "excessive twist",
    "FE": "limit error",
    "FS": "stalled and stopped",
    "WR": "no reference position, as after a loss of power",
    "WH": "its position is known, and it was not homed since power-on",
    "WL": "unexpected limit trigger",
    "WS": "stalled and recovered",
    "WM": "displaced while stationary",
    "WV": "supply voltage out of range",
    "WT": "controller temperature",
    "WP": "bad calibration type",
    "NI": "movement interrupted by a newer command",
    "NC": "manual control",
    "ND": "stream discontinuity",
    "NR": "value rounded",
    "NT": "value truncated",
    "NU": "setting update pending",
    "NJ": "joystick calibrating",
    "NB": "firmware update mode",
}
UNREFERENCED = frozenset({"WR", "WH"})
INTERRUPTED = frozenset({"NI", "NC"})
OFF_PATH = frozenset({"WS", "WL"}) | INTERRUPTED
"""Flags of an axis that arrives and was not on its path: it stalled and recovered, met a limit, was interrupted."""

REJECTIONS: dict[str, str] = {
    "BADCOMMAND": "the command is unknown or incomplete",
    "BADDATA": "a value is out of range",
    "BADAXIS": "no such axis",
    "BADMESSAGEID": "the message id is not a number from 0 to 99",
    "STATUSBUSY": "not while moving",
    "DRIVERDISABLED": "the driver is disabled",
    "PARKED": "the axis is parked",
    "LOCKSTEP": "the axis moves in lockstep with another",
    "AGAIN": "not now, try again",
    "FULL": "no room is left",
    "NOACCESS": "the access level is too low",
    "DEVICEONLY": "only for the whole device",
}


def is_fault(flag: str) -> bool:
    """Return whether a flag says that the axis cannot work."""
    return flag.startswith("F")


def describe(flag: str) -> str:
    """Return a flag with its meaning."""
    return f"{flag} ({FLAGS.get(flag, 'unknown flag')})"
