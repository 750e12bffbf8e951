"""GRBL controllers as built: firmware families, compile-time options, settings, and how an AVR times its steps.

Facts, with their places:

- gnea/grbl (bfb67f0), report.c, report_build_info: letters of `[OPT:]`; `Z` is HOMING_FORCE_SET_ORIGIN, `H` are single
  axis homing commands, `+` is the safety door, `L` says that homing does not lock the controller at power-on.
- stepper.c, st_prep_buffer: the step timer counts whole cycles, of which AMASS makes 1, 2, 4 or 8 ticks a step; a tick
  takes at most 65536 cycles, so that no axis steps slower than 16 MHz / 65536 / 8 = 30.5 steps/s, and OCR1A holds the
  cycles, not one less, so that each tick takes a cycle more than computed. planner.c clamps to MINIMUM_FEED_RATE.
- grblHAL core (f80fc34), report.c, report_init_message: "GrblHAL 1.1f ['$' or '$HELP' for help]"; `[FIRMWARE:grblHAL]`.
- bdring/FluidNC (c47d53c), SettingsDefinitions.cpp, make_settings: the greeting is the setting Start/Message, any text;
  make_proxies: `$$` has no `$1`, `$13`, and only the axes that are configured. Limit.cpp: the travel begins at the
  homing position `mpos_mm`.

Here: records and arithmetic. Not here: what the controller does (`grbl`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import ceil, inf

from gs2ci_sims.axis_motion import Mechanics

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
    """

    greeting: bytes = b"Grbl 1.1h ['$' for help]"
    version: str = "1.1h.20190825:"
    options: str = "V"
    axes: int = 3
    avr: bool = True
    unlisted: frozenset[int] = frozenset()
    extra: tuple[str, ...] = ()
    homing_mm: Mapping[int, float] | None = None


GRBL = GrblBuild()


@dataclass
class GrblMachine:
    """A machine as built and set up.

    Args:
        settings: Values of `$n`, on top of the defaults.
        start_mm: Machine position at power-on.
        homed: Whether it has been homed before (otherwise it is locked in Alarm if homing is enabled).
        mechanics: For each axis the errors between counted and true position.
        build: Its firmware.
        startup: Its startup lines `$N0` and `$N1`.
        switches: Axes that have a reference switch.
        offset_mm: Work coordinate offset.
    """

    settings: Mapping[int, float] = field(default_factory=dict)
    start_mm: tuple[float, float, float] = (-100.0, -100.0, -10.0)
    homed: bool = True
    mechanics: Mapping[str, Mechanics] = field(default_factory=dict)
    build: GrblBuild = GRBL
    startup: tuple[str, str] = ("", "")
    switches: str = "xyz"
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def stepped_rate_hz(rate_hz: float) -> float:
    """Return the steps a second that an AVR's timer makes of a wanted rate."""
    cycles = ceil(CLOCK_HZ / rate_hz) if rate_hz > 0 else inf
    level = sum(cycles >= edge for edge in AMASS_CYCLES)
    ticks = LONGEST_TICK if cycles == inf else min(int(cycles) >> level, LONGEST_TICK)
    return CLOCK_HZ / ((ticks + 1) << level)


def inside(build: GrblBuild, settings: Mapping[int, float], i: int, position_mm: float) -> bool:
    """Return whether a position lies in an axis' travel (system.c, system_check_travel_limits)."""
    low_mm, high_mm = travel_mm(build, settings, i)
    return low_mm <= position_mm <= high_mm


def travel_mm(build: GrblBuild, settings: Mapping[int, float], i: int) -> tuple[float, float]:
    """Return the ends of an axis' travel."""
    length_mm, negative = settings[130 + i], bool(int(settings[23]) >> i & 1)
    if build.homing_mm is not None:
        home_mm = build.homing_mm[i]
        return (home_mm, home_mm + length_mm) if negative else (home_mm - length_mm, home_mm)
    return (0.0, length_mm) if "Z" in build.options and negative else (-length_mm, 0.0)


def homed_mm(build: GrblBuild, settings: Mapping[int, float], i: int) -> float:
    """Return what an axis counts after homing (limits.c, limits_go_home), pulled off its switch."""
    pulloff_mm, negative = settings[27], bool(int(settings[23]) >> i & 1)
    if build.homing_mm is not None:
        return build.homing_mm[i]
    if "Z" in build.options:
        return 0.0
    return pulloff_mm - settings[130 + i] if negative else -pulloff_mm


def switch_mm(build: GrblBuild, settings: Mapping[int, float], i: int) -> tuple[float, float]:
    """Return where an axis' switch lies on its screw, and the sign of the way to it."""
    way = -1.0 if int(settings[23]) >> i & 1 else 1.0
    return homed_mm(build, settings, i) + way * settings[27], way


def report_numbers(values: list[float], settings: Mapping[int, float]) -> str:
    """Return coordinates as in a report: three decimals, or inches with four."""
    if settings[13]:
        return ",".join(f"{value / 25.4:.4f}" for value in values)
    return ",".join(f"{value:.3f}" for value in values)
