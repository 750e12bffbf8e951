"""An axis of a stage, and the arithmetic of moving it at constant speed.

Here: what an axis is, the sweep and its run-up. Not here: the stage (`stage`), whether a sweep went as planned
(`sweep_check`).
"""

from dataclasses import dataclass
from math import ceil, copysign, isfinite

from gs2ci_drivers.failures import OutOfRangeError

TOO_SLOW = " is slower than it can step"
RAMP_MARGIN = 1.1
"""The run-up is this much longer than v²/2a says: drivers round accelerations and settle at the end of a ramp."""


@dataclass(frozen=True)
class AxisInfo:
    """One axis of a stage.

    Args:
        name: Its name in the rig file ("x").
        min_mm: Lower limit of travel.
        max_mm: Upper limit of travel.
        step_mm: Positions are multiples of this.
        max_speed_mm_s: Highest speed.
        speed_step_mm_s: Speeds are multiples of this.
        acceleration_mm_s2: Acceleration of its ramps.
        min_speed_mm_s: Lowest speed that it can keep; 0 if none is known.
        window_mm: How far from its target it may rest, by its own tolerance.
        report_mm: Resolution of the positions that it reports, where that is coarser than a step.
        braking_mm_s2: Acceleration of the ramps at the end of its moves, where it is another one.
        rounding_s: Time in which its acceleration grows at the begin of a ramp and falls at its end; 0: at once.
    """

    name: str
    min_mm: float
    max_mm: float
    step_mm: float
    max_speed_mm_s: float
    speed_step_mm_s: float
    acceleration_mm_s2: float
    min_speed_mm_s: float = 0.0
    window_mm: float = 0.0
    report_mm: float = 0.0
    braking_mm_s2: float | None = None
    rounding_s: float = 0.0

    @property
    def error_mm(self) -> float:
        """Get by how much a reported position may differ from the commanded one without any fault."""
        return max(self.step_mm + self.report_mm, self.window_mm)

    def keeps_mm_s(self, speed_mm_s: float) -> bool:
        """Return whether it can keep a speed; the slack admits limits that were rounded."""
        return self.min_speed_mm_s * (1 - 1e-9) <= speed_mm_s <= self.max_speed_mm_s * (1 + 1e-9) and speed_mm_s > 0

    @property
    def speeds(self) -> str:
        """Get the speeds that it can keep, for messages."""
        least = f"{self.min_speed_mm_s:.4g}" if self.min_speed_mm_s else "above 0"
        return f"{least} to {self.max_speed_mm_s:g} mm/s"

    def ramps_s(self, speed_mm_s: float) -> tuple[float, float]:
        """Return how long it takes to reach a speed, and to come to rest.

        A rounded ramp is symmetrical as well: its mean speed is half of the one that it reaches.
        """
        ends = self.acceleration_mm_s2, self.braking_mm_s2 or self.acceleration_mm_s2
        begin_s, end_s = (speed_mm_s / one + self.rounding_s for one in ends)
        return begin_s, end_s

    def quantise_mm(self, position_mm: float) -> float:
        """Return the nearest position that the axis can take; NaN and infinities are returned as they are."""
        return round(position_mm / self.step_mm) * self.step_mm if isfinite(position_mm) else position_mm

    def quantise_speed_mm_s(self, speed_mm_s: float) -> float:
        """Return the nearest speed that the axis can keep, never zero."""
        steps = max(
            1, round(speed_mm_s / self.speed_step_mm_s), ceil(self.min_speed_mm_s / self.speed_step_mm_s - 1e-6)
        )
        return steps * self.speed_step_mm_s


@dataclass(frozen=True)
class Sweep:
    """A move along one axis that crosses [from_mm, to_mm] at constant speed, its ramps outside.

    Args:
        axis: Which axis.
        from_mm: Where the constant part begins (quantised).
        to_mm: Where it ends (quantised).
        speed_mm_s: Its speed (quantised), positive.
        begin_mm: Where the stage waits before the sweep.
        end_mm: Where it comes to rest after it.
        lead_s: From the start of motion to crossing `from_mm`.
        ramps_s: How long its ramps take, the first and the last.
        rounding_s: As `AxisInfo.rounding_s`.
    """

    axis: str
    from_mm: float
    to_mm: float
    speed_mm_s: float
    begin_mm: float
    end_mm: float
    lead_s: float
    ramps_s: tuple[float, float]
    rounding_s: float = 0.0

    @property
    def cruise_s(self) -> float:
        """Get how long the constant part lasts."""
        return abs(self.to_mm - self.from_mm) / self.speed_mm_s

    @property
    def accelerations_mm_s2(self) -> tuple[float, float]:
        """Get the accelerations of its first and its last ramp."""
        first_s, last_s = self.ramps_s
        return self.speed_mm_s / (first_s - self.rounding_s), self.speed_mm_s / (last_s - self.rounding_s)

    def position_mm(self, since_from_s: float) -> float:
        """Return where the axis is, `since_from_s` after crossing `from_mm`, while the speed is constant."""
        return self.from_mm + copysign(self.speed_mm_s, self.to_mm - self.from_mm) * since_from_s


def trapezoid_time_s(distance_mm: float, speed_mm_s: float, acceleration_mm_s2: float) -> float:
    """Return the time of a move with equal ramps: a trapezoid of speed, or a triangle when it is short."""
    distance = abs(distance_mm)
    ramp = speed_mm_s**2 / acceleration_mm_s2  # both ramps together
    if distance >= ramp:
        return distance / speed_mm_s + speed_mm_s / acceleration_mm_s2
    return float(2.0 * (distance / acceleration_mm_s2) ** 0.5)


def plan_sweep(device: str, axis: AxisInfo, from_mm: float, to_mm: float, speed_mm_s: float) -> Sweep:
    """Lay out a sweep whose ramps lie outside [from_mm, to_mm].

    Raises:
        OutOfRangeError: No distance, a speed the axis cannot keep, or ends beyond the limits.
    """
    asked = f"sweep {axis.name} from {from_mm:g} to {to_mm:g} mm at {speed_mm_s:g} mm/s"
    start, stop = axis.quantise_mm(from_mm), axis.quantise_mm(to_mm)
    if start == stop:
        raise OutOfRangeError(device, "no distance", asked=asked, allowed=f"at least {axis.step_mm:g} mm")
    if not axis.keeps_mm_s(speed_mm_s):
        slow = 0 < speed_mm_s < axis.min_speed_mm_s
        problem = f"speed {speed_mm_s:.4g} mm/s{TOO_SLOW}" if slow else "no such speed"
        raise OutOfRangeError(device, problem, asked=asked, allowed=axis.speeds)
    speed = axis.quantise_speed_mm_s(speed_mm_s)
    ramps_s = axis.ramps_s(speed)
    ramps = [speed * ramp_s / 2 for ramp_s in ramps_s]
    run_up, run_out = (max(ramp * RAMP_MARGIN, ramp + axis.step_mm) for ramp in ramps)
    direction = copysign(1.0, stop - start)
    begin = axis.quantise_mm(start - direction * run_up)
    end = axis.quantise_mm(stop + direction * run_out)
    for edge in (begin, end):
        check_inside(device, axis, edge, asked + " with its run-up")
    lead_s = ramps_s[0] + (abs(start - begin) - ramps[0]) / speed
    return Sweep(axis.name, start, stop, speed, begin, end, lead_s, ramps_s, axis.rounding_s)


def check_inside(device: str, axis: AxisInfo, position_mm: float, asked: str) -> None:
    """Check that a position lies inside an axis' travel.

    Raises:
        OutOfRangeError: It does not.
    """
    slack = axis.step_mm * 1e-6  # the rounding error of step counts in floating point
    if not axis.min_mm - slack <= position_mm <= axis.max_mm + slack:
        raise OutOfRangeError(
            device,
            f"{position_mm:g} mm is beyond the limits of axis {axis.name}",
            asked=asked,
            allowed=f"{axis.min_mm:g} to {axis.max_mm:g} mm",
        )
