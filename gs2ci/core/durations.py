"""Durations as users type them: `60s`, `2min`, `1.5h`, or a bare number of seconds."""

import math
import re
from typing import Final

from gs2ci.core.errors import InputError

_UNITS_S: Final = {"": 1.0, "s": 1.0, "sec": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
_FORM: Final = re.compile(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)\s*", re.IGNORECASE)


def parse_duration_s(text: str | float) -> float:
    """Read a duration, in seconds, above 0; from Python a bare number of seconds may be one.

    Raises:
        InputError: Not a positive number with one of the units s, min and h.
    """
    found = _FORM.fullmatch(str(text))
    unit = found.group(2).lower() if found else ""
    seconds = float(found.group(1)) * _UNITS_S[unit] if found and unit in _UNITS_S else 0.0
    if not 0 < seconds < math.inf:
        raise InputError(f"{text!r} is no duration", allowed="a number above 0 with s, min or h, as in 90s, 2min, 1.5h")
    return seconds


def spoken_duration(seconds: float) -> str:
    """Write a duration for a sentence: `0.8 s`, `42 s`, `3 min 20 s`, `1 h 05 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 120:
        return f"{whole} s"
    if whole < 7200:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
