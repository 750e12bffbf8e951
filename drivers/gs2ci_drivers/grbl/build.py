"""What a GRBL controller says of its firmware and its settings, and what follows from it. Pure; no port, no time.

Sources: gnea/grbl (bfb67f0) report.c, report_build_info; limits.c, limits_go_home; system.c,
system_check_travel_limits; stepper.c, st_prep_buffer; grblHAL core (f80fc34) report.c; bdring/FluidNC (c47d53c)
Limit.cpp and SettingsDefinitions.cpp.

Here: families, options, travel, warnings. Not here: lines (`packets`), what a stage does (`driver`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil

from gs2ci_drivers.axis import AxisInfo

LETTERS = ("x", "y", "z")
AVR_HZ = 16_000_000
"""An AVR's step timer counts cycles of this clock, at most 65536 of them in one tick, 1, 2, 4 or 8 ticks to a step."""
TICK_CYCLES = 65536
LEVELS = (AVR_HZ // 8000, AVR_HZ // 4000, AVR_HZ // 2000)
LOWEST_RATE_HZ = AVR_HZ / (TICK_CYCLES << len(LEVELS))
LOWEST_FEED_MM_S = 1.0 / 60.0
"""MINIMUM_FEED_RATE of the planner, 1 mm/min."""
LOCK_MS = 255.0
"""`$1` of which nobody has heard: the longest."""
_MOTION = re.compile(r"[XYZABC]-?[\d.]|G28|G30|\$H", re.IGNORECASE)


@dataclass(frozen=True)
class Build:
    """A controller's firmware with its settings.

    Args:
        version: Version text.
        family: "grbl" (on an AVR), "grblHAL" or "FluidNC".
        options: Letters of `[OPT:]`.
        settings: Values of `$n`.
        startup: Startup lines by their names.
        homing_mm: Where axes stand after homing, by number, where the firmware has this as a setting of its own.
        idle_ms: FluidNC's delay until the motors are switched off (stepping: idle_ms); 255 is never, as with `$1`.
    """

    version: str = ""
    family: str = "grbl"
    options: str = ""
    settings: Mapping[int, float] = field(default_factory=dict)
    startup: Mapping[str, str] = field(default_factory=dict)
    homing_mm: Mapping[int, float] = field(default_factory=dict)
    idle_ms: float | None = None

    @property
    def homing_enabled(self) -> bool:
        """Get whether homing is enabled: `$22`, a set of flags on some firmware."""
        return bool(self.settings.get(22))

    @property
    def knows_restarts(self) -> bool:
        """Get whether the controller is locked after it was switched on, until it is homed."""
        return self.homing_enabled and "L" not in self.options

    @property
    def inches(self) -> bool:
        """Get whether reports are in inches."""
        return bool(self.settings.get(13))

    @property
    def lock_s(self) -> float:
        """Get for how long the controller stands still when its motors are stopped, `$1`."""
        return self.settings.get(1, LOCK_MS) / 1000

    def travel_mm(self, axis: str) -> tuple[float, float]:
        """Return the ends of an axis' travel, where soft limits and homing see them."""
        i = LETTERS.index(axis)
        length_mm, negative = self.settings.get(130 + i, 0.0), bool(int(self.settings.get(23, 0)) >> i & 1)
        if i in self.homing_mm:
            home_mm = self.homing_mm[i]
            return (home_mm, home_mm + length_mm) if negative else (home_mm - length_mm, home_mm)
        return (0.0, length_mm) if "Z" in self.options and negative else (-length_mm, 0.0)

    def lowest_mm_s(self, axis: str) -> float:
        """Return the lowest speed that an axis can keep; faster processors have no limit of their own."""
        steps_per_mm = self.settings[100 + LETTERS.index(axis)]
        return max(LOWEST_RATE_HZ / steps_per_mm if self.family == "grbl" else 0.0, LOWEST_FEED_MM_S)

    def motions(self) -> list[str]:
        """Return the startup lines that move something: they run at each reset and after homing."""
        return [f"{name}={line}" for name, line in self.startup.items() if _MOTION.search(line)]

    def warnings(self, axes: Sequence[str]) -> list[str]:
        """Return what a user of these axes should know."""
        found = []
        if not self.homing_enabled:
            found.append("homing is disabled ($22=0): positions count from power-on")
        for name, idle_ms in (("$1", self.settings.get(1)), ("idle_ms of stepping", self.idle_ms)):
            if idle_ms is not None and idle_ms != LOCK_MS:
                found.append(f"the motors are switched off {idle_ms:g} ms after every move: set {name}=255")
        if self.homing_enabled and not self.homes_single and self.family != "FluidNC" and len(axes) < len(LETTERS):
            others = ", ".join(axis for axis in LETTERS if axis not in axes)
            found.append(f"homing drives {others} too, z first: a build for this stage homes its own axes only")
        if self.homing_enabled and not self.knows_restarts:
            found.append("the firmware does not lock after power-on ([OPT:] has L): home it in each session")
        return found

    @property
    def homes_single(self) -> bool:
        """Get whether `$HX` homes x alone."""
        return "H" in self.options


@dataclass(frozen=True)
class SteppedAxis(AxisInfo):
    """An axis whose steps an AVR's timer makes: its speeds are whole numbers of cycles a tick.

    A tick takes a cycle more than the firmware computes (OCR1A holds the cycles, not one less), so that speeds are
    lower than asked by up to 0.1 %.
    """

    def quantise_speed_mm_s(self, speed_mm_s: float) -> float:
        """Return the nearest speed that the axis can keep."""
        cycles, level = self._ticks(speed_mm_s)
        return AVR_HZ / ((cycles + 1) << level) * self.step_mm

    def asked_mm_s(self, speed_mm_s: float) -> float:
        """Return the speed to ask for, which the firmware turns into this one."""
        cycles, level = self._ticks(speed_mm_s)
        # The firmware rounds the cycles of a step up, and then shifts them: this lies in the middle of what it takes.
        return AVR_HZ / ((cycles << level) + (1 << level) / 2 - 1) * self.step_mm

    def _ticks(self, speed_mm_s: float) -> tuple[int, int]:
        """Return the cycles of a tick as the firmware computes them, and the level of its smoothing."""
        a_step, least = (AVR_HZ * self.step_mm / limit_mm_s for limit_mm_s in (speed_mm_s, self.max_speed_mm_s))
        level = sum(ceil(a_step) > edge for edge in LEVELS)
        cycles = max(round(a_step / (1 << level)) - 1, ceil(least - 1e-6) >> level)
        return min(cycles, TICK_CYCLES - 1), level


def read_build(lines: Sequence[str], settings: Mapping[int, float], startup: Mapping[str, str]) -> Build:
    """Read the answer to `$I`."""
    version, options, family = "", "", "grbl"
    for line in lines:
        if line.startswith("[VER:"):
            version = line.removeprefix("[VER:").rstrip("]").rstrip(": ")
            family = "FluidNC" if "FluidNC" in line else family
        elif line.startswith("[OPT:"):
            options = line.removeprefix("[OPT:").partition(",")[0].rstrip("]")
        elif line == "[FIRMWARE:grblHAL]":
            family = "grblHAL"
    return Build(version, family, options, dict(settings), dict(startup))
