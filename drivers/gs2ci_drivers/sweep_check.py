"""Whether a stage kept to its sweep: as many positions as its line gives, each held against the planned path.

An answer was true at some time between its question and its arrival, to within `AxisInfo.error_mm`. So each position
says between which two times the sweep can have been shifted against its plan. An undisturbed sweep has a shift that all
its positions allow; where none is left the path was another one, by more than the answers leave open, and there is no
threshold to be tuned. A constant shift (the time of a command, a late start) is no fault: the poses are computed with
it. Nor is a speed that is off by less than `SPEED_TOLERANCE` (another crystal). It is stated; the poses keep the
planned speed from where the sweep began, since a calibration of the stage corrects it from there.

What a device does not tell cannot be found here: a controller that counts the steps it has sent does not notice a
motor that has lost some.

Here: positions and what they allow. Not here: when they are read during a capture (`stage_watch`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import copysign, inf, isfinite, sqrt

from gs2ci.core.clock import Clock
from gs2ci_drivers.axis import AxisInfo, Sweep
from gs2ci_drivers.failures import PathError
from gs2ci_drivers.stage import Stage

SPEED_TOLERANCE = 0.01
"""A ceramic resonator, which times most Arduinos, may be off by 0.5 %."""
SPEEDS_TRIED = 41
RAMP_SLACK_S = 0.01
RAMP_SLACK = 0.1
"""Ramps are known less well than the part of constant speed: by so much, and this share of their time. Firmware
computes them in steps of 10 ms, or rounds their corners."""
FIRST = 3
"""Of so many positions the one that was answered most quickly says when a sweep was where it began."""
MOST_POSITIONS = 1000
"""About so many of one sweep: longer ones are read less often than the line allows."""


@dataclass(frozen=True)
class Path:
    """Where an axis was during a sweep.

    Args:
        sweep: The planned one.
        crossed_s: When `sweep.from_mm` was to be crossed, on the devices' clock.
        shift_s: By how much later it was.
        speed_factor: By how much faster it was.
        error_mm: By how much any position may be off.
        positions: How many were read.
    """

    sweep: Sweep
    crossed_s: float
    shift_s: float
    speed_factor: float
    error_mm: float
    positions: int

    def position_mm(self, when_s: float) -> float:
        """Return where the axis was while its speed was constant: at the planned speed, from `sweep.from_mm` on."""
        return self.sweep.position_mm(when_s - self.crossed_s - self.shift_s)

    def outside_s(self, begin_s: float, end_s: float) -> float:
        """Return for how long of this interval the speed was not constant yet, or no more."""
        before_s = self.crossed_s + self.shift_s - begin_s
        after_s = end_s - (self.crossed_s + self.shift_s + self.sweep.cruise_s / self.speed_factor)
        return max(before_s, after_s, 0.0)


@dataclass
class SweepCheck:
    """The positions of one sweep.

    Args:
        device: Name of the stage, for messages.
        axis: The axis that is swept.
        sweep: Its sweep.
        crossed_s: When `sweep.from_mm` is to be crossed.
    """

    device: str
    axis: AxisInfo
    sweep: Sweep
    crossed_s: float
    read: list[tuple[float, float, float]] = field(default_factory=list)
    """Time of each question and of its answer, and the position."""

    def __post_init__(self) -> None:
        self._profile = _Profile(self.sweep)

    def ask(self, stage: Stage, clock: Clock) -> None:
        """Read the position once.

        Raises:
            As `Stage.position_mm`.
        """
        before_s = clock.now_s()
        position_mm = stage.position_mm(self.sweep.axis)
        self.read.append((before_s, clock.now_s(), position_mm))

    def ask_until(self, until_s: float, stage: Stage, clock: Clock) -> None:
        """Read positions as often as the line and the stage allow, until a time.

        Raises:
            As `Stage.position_mm`.
        """
        gap_s = max(stage.sample_gap_s, self.sweep.cruise_s / MOST_POSITIONS)
        while True:
            due_s = self.read[-1][0] + gap_s if self.read else clock.now_s()
            if max(due_s, clock.now_s()) >= until_s:
                return
            clock.sleep_s(due_s - clock.now_s())
            self.ask(stage, clock)

    @property
    def error_mm(self) -> float:
        """Get by how much a position may be off: the axis' own error, and its way during half an exchange."""
        halves_s = sorted((answered_s - asked_s) / 2 for asked_s, answered_s, _ in self.read)
        middle_s = halves_s[len(halves_s) // 2] if halves_s else 0.0
        return self.axis.error_mm + self.sweep.speed_mm_s * middle_s

    def path(self) -> Path:
        """Return where the axis was.

        Raises:
            PathError: No sweep passes all positions.
        """
        low_s, high_s = self._shifts_s(1.0)
        factor = 1.0
        if low_s > high_s:
            span = [1 + SPEED_TOLERANCE * (2 * i / (SPEEDS_TRIED - 1) - 1) for i in range(SPEEDS_TRIED)]
            factor = max(span, key=self._room_s)
            if self._room_s(factor) < 0:
                raise self._error(low_s - high_s)
            low_s, high_s = self._shifts_s(factor)
        # The first positions are those from which a calibration counts what a wrong speed adds.
        first_s = sum(self._shifts_s(factor, self._first())) / 2
        shift_s = min(max(first_s if isfinite(first_s) else 0.0, low_s), high_s)
        return Path(self.sweep, self.crossed_s, shift_s, factor, self.error_mm, len(self.read))

    def _first(self) -> list[tuple[float, float, float]]:
        """Return the quickest answer of the first ones in the part of constant speed, or the first of all."""
        ends_mm = sorted((self.sweep.from_mm, self.sweep.to_mm))
        early = [one for one in self.read if ends_mm[0] <= one[2] <= ends_mm[1]][:FIRST] or self.read[:1]
        return sorted(early, key=lambda one: round(one[1] - one[0], 4))[:1]

    def _room_s(self, factor: float) -> float:
        low_s, high_s = self._shifts_s(factor)
        return high_s - low_s

    def _shifts_s(self, factor: float, read: Sequence[tuple[float, float, float]] | None = None) -> tuple[float, float]:
        """Return the least and the largest shift that all positions allow; the least is larger where none is left."""
        lows, highs = [-inf], [inf]
        for asked_s, answered_s, position_mm in self.read if read is None else read:
            earliest_s, latest_s = self._due_s(position_mm, factor)
            lows.append(asked_s - self.crossed_s - latest_s)
            highs.append(answered_s - self.crossed_s - earliest_s)
        return max(lows), min(highs)

    def _due_s(self, position_mm: float, factor: float) -> tuple[float, float]:
        """Return when the planned sweep is here at the earliest and at the latest, from crossing `from_mm`."""
        sweep = self.sweep
        way = copysign(1.0, sweep.to_mm - sweep.from_mm)
        gone_mm, error_mm = (position_mm - sweep.from_mm) * way, self.axis.error_mm
        return self._profile.when_s(gone_mm - error_mm, factor)[0], self._profile.when_s(gone_mm + error_mm, factor)[1]

    def _error(self, short_s: float) -> PathError:
        off_mm = short_s * self.sweep.speed_mm_s
        sweep, count = self.sweep, len(self.read)
        return PathError(
            self.device,
            f"axis {sweep.axis} left its path by {off_mm:.3g} mm or more: no sweep at {sweep.speed_mm_s:.4g} mm/s "
            f"passes the {count} positions that were read",
            asked=f"sweep {sweep.axis} from {sweep.from_mm:.4g} to {sweep.to_mm:.4g} mm",
            allowed=f"{self.error_mm:.3g} mm",
            remedy="look for an obstacle, a hand or a cable on the stage, and for missing lubrication; a lower speed "
            "may help; allow a second attempt with `retries = 1` in [capture]",
        )


class _Profile:
    """The planned sweep from rest to rest, as times of positions along its way."""

    def __init__(self, sweep: Sweep) -> None:
        self._speed = sweep.speed_mm_s
        self._accelerating, self._braking = sweep.accelerations_mm_s2
        self._length_mm = abs(sweep.to_mm - sweep.from_mm)
        self._before_mm = abs(sweep.from_mm - sweep.begin_mm)
        self._after_mm = abs(sweep.end_mm - sweep.to_mm)
        self._lead_s = sweep.lead_s
        self._ramp_mm, self._brake_mm = (sweep.speed_mm_s * ramp_s / 2 for ramp_s in sweep.ramps_s)
        self._slack_s = RAMP_SLACK_S + RAMP_SLACK * max(sweep.ramps_s) + sweep.rounding_s

    def when_s(self, gone_mm: float, factor: float) -> tuple[float, float]:
        """Return the first and the last time at which it may be so far beyond `from_mm`."""
        speed, cruise_s = self._speed * factor, self._length_mm / (self._speed * factor)
        begun_mm, over_mm = gone_mm + self._before_mm, gone_mm - self._length_mm
        if begun_mm <= 0:
            return -inf, -self._lead_s
        if begun_mm < self._ramp_mm:
            ramped_s = -self._lead_s + sqrt(2 * begun_mm / self._accelerating)
            return ramped_s - self._slack_s, min(ramped_s + self._slack_s, gone_mm / speed)
        if over_mm <= 0:
            return gone_mm / speed, gone_mm / speed
        # However it brakes, it is never faster than at constant speed.
        flat_mm, flat_s = self._after_mm - self._brake_mm, cruise_s + over_mm / speed
        if over_mm <= flat_mm:
            return flat_s, flat_s
        braked_mm = min(over_mm - flat_mm, self._brake_mm)
        left_mm_s = sqrt(max(self._speed**2 - 2 * self._braking * braked_mm, 0.0))
        braked_s = cruise_s + flat_mm / speed + (self._speed - left_mm_s) / self._braking
        latest_s = inf if over_mm >= self._after_mm else braked_s + self._slack_s
        return max(flat_s, braked_s - self._slack_s), latest_s
