"""A GRBL controller's machine, its settings, and how an AVR times its steps.

Facts, with their places:

- gnea/grbl (bfb67f0), stepper.c, st_prep_buffer: the step timer counts whole cycles, of which AMASS makes 1, 2, 4 or 8
  ticks a step; a tick takes at most 65536 cycles, so that no axis steps slower than 16 MHz / 65536 / 8 = 30.5 steps/s,
  and OCR1A holds the cycles, not one less, so that each tick takes a cycle more than computed.
- planner.c clamps to MINIMUM_FEED_RATE.

Here: records and arithmetic. Not here: what the controller does (`grbl`), other firmware (`tests/twins/grbl.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil, inf

from gs2ci.core.mechanics import Mechanics

AXES = ("x", "y", "z")
CLOCK_HZ = 16_000_000
LONGEST_TICK = 65535
AMASS_CYCLES = (CLOCK_HZ // 8000, CLOCK_HZ // 4000, CLOCK_HZ // 2000)
LEAST_FEED_MM_S = 1.0 / 60.0
"""MINIMUM_FEED_RATE of config.h, 1 mm/min."""

DEFAULTS: dict[int, float] = {
    1: 255, 10: 1, 13: 0, 20: 1, 21: 1, 22: 1, 23: 0, 24: 25, 25: 500, 26: 250, 27: 1,
    100: 320, 101: 320, 102: 320, 110: 1800, 111: 1800, 112: 600,
    120: 200, 121: 200, 122: 100, 130: 200, 131: 200, 132: 60,
}  # fmt: skip


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


def stepped_rate_hz(rate_hz: float) -> float:
    """Return the steps a second that an AVR's timer makes of a wanted rate."""
    cycles = ceil(CLOCK_HZ / rate_hz) if rate_hz > 0 else inf
    level = sum(cycles >= edge for edge in AMASS_CYCLES)
    ticks = LONGEST_TICK if cycles == inf else min(int(cycles) >> level, LONGEST_TICK)
    return CLOCK_HZ / ((ticks + 1) << level)


def report_numbers(values: list[float], settings: Mapping[int, float]) -> str:
    """Return coordinates as in a report: three decimals, or inches with four."""
    if settings[13]:
        return ",".join(f"{value / 25.4:.4f}" for value in values)
    return ",".join(f"{value:.3f}" for value in values)
