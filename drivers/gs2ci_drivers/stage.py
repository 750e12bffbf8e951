"""The motion stage's interface: named axes in millimetres.

The public methods check and keep the order of calls; a driver writes only the private `_do_*` hooks.

Promises that every implementation keeps and `tests/contracts/test_stage.py` tests: connecting moves nothing and
resets nothing that answers; homing happens only on request, and ends at rest if it is interrupted; a target beyond the
limits is refused, never clipped; positions are in mm and the quantised value is returned; a move that did not reach its
target is an error; `stop` may be called in any state and more than once; `close` may be called twice and does not stop
a move.

Here: the records, the sweep's arithmetic, the abstract class. Not here: bytes (each driver's package).
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import copysign, isfinite

from gs2ci_drivers.device import Device
from gs2ci_drivers.failures import HOME_COMMAND, DriverError, OutOfRangeError, ReferenceLostError, WrongStateError

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
    """

    name: str
    min_mm: float
    max_mm: float
    step_mm: float
    max_speed_mm_s: float
    speed_step_mm_s: float
    acceleration_mm_s2: float

    def quantise_mm(self, position_mm: float) -> float:
        """Return the nearest position that the axis can take; NaN and infinities are returned as they are."""
        return round(position_mm / self.step_mm) * self.step_mm if isfinite(position_mm) else position_mm

    def quantise_speed_mm_s(self, speed_mm_s: float) -> float:
        """Return the nearest speed that the axis can keep, never zero."""
        return max(1, round(speed_mm_s / self.speed_step_mm_s)) * self.speed_step_mm_s


@dataclass(frozen=True)
class StageInfo:
    """What a stage is.

    Args:
        model: Maker and model.
        serial: Serial number, or "" if it has none.
        firmware: Version text.
        axes: Its axes by name.
    """

    model: str
    serial: str
    firmware: str
    axes: Mapping[str, AxisInfo]


@dataclass(frozen=True)
class StageStatus:
    """What a stage reports of itself.

    Args:
        moving: Whether any axis moves.
        referenced: Whether all axes have their reference position.
        positions_mm: Positions of the axes.
        faults: Faults that stop it from working, in the device's own terms with their meaning.
        warnings: Warnings and notes that do not stop it.
    """

    moving: bool
    referenced: bool
    positions_mm: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


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
    """

    axis: str
    from_mm: float
    to_mm: float
    speed_mm_s: float
    begin_mm: float
    end_mm: float
    lead_s: float

    @property
    def cruise_s(self) -> float:
        """Get how long the constant part lasts."""
        return abs(self.to_mm - self.from_mm) / self.speed_mm_s

    def position_mm(self, since_from_s: float) -> float:
        """Return where the axis is, `since_from_s` after crossing `from_mm`, while the speed is constant."""
        return self.from_mm + copysign(self.speed_mm_s, self.to_mm - self.from_mm) * since_from_s


class Stage(Device[StageInfo, StageStatus]):
    """A device that moves the camera.

    `close` does not stop a move.
    """

    def home(self, axes: Sequence[str] = (), *, timeout_s: float = 120.0) -> dict[str, float]:
        """Find the reference of these axes (all when none are named); return all positions in mm.

        If it fails or is interrupted, the stage is stopped.

        Raises:
            OutOfRangeError: No such axis.
            NoAnswerError: Not done in time.
            MoveFailedError: The reference was not found.
        """
        names = self._axes(axes)
        try:
            self._do_home(names, timeout_s)
        except BaseException:
            with suppress(DriverError):
                self._do_stop()
            raise
        return self.positions_mm()

    def begin_move(self, targets_mm: Mapping[str, float], *, speed_mm_s: float | None = None) -> dict[str, float]:
        """Start a move and return at once with the quantised targets.

        Args:
            targets_mm: Target of each axis to be moved.
            speed_mm_s: Speed of the fastest axis; None takes the axis's highest.

        Raises:
            OutOfRangeError: No such axis, beyond the limits, or too fast; nothing moved.
            WrongStateError: It moves already.
            ReferenceLostError: The stage has lost its reference position; home it first.
            RefusedError, LinkError: The device did not accept the command.
        """
        quantised = self.check_targets(targets_mm)
        if not quantised:
            return {}
        speed = self._check_speed(tuple(quantised), speed_mm_s)
        status = self._do_status()
        if status.moving:
            raise WrongStateError(
                self.name, "moving", asked=f"move to {quantised}", remedy="call wait_idle() or stop() first"
            )
        if not status.referenced:
            raise ReferenceLostError(
                self.name,
                f"move to {quantised}",
                ["no reference position"],
                remedy=f"home the stage: `{HOME_COMMAND}` (it will move to its reference switch)",
            )
        self._do_begin_move(quantised, speed)
        return quantised

    def move_to(
        self, targets_mm: Mapping[str, float], *, speed_mm_s: float | None = None, timeout_s: float | None = None
    ) -> dict[str, float]:
        """Move and wait for the arrival; return all positions in mm.

        Args:
            targets_mm: Target of each axis to be moved.
            speed_mm_s: Speed; None takes the axis's highest.
            timeout_s: Deadline; None takes `move_timeout_s`.

        Raises:
            OutOfRangeError, ReferenceLostError, RefusedError, LinkError: As `begin_move`.
            MoveFailedError: It stopped before the target.
            NoAnswerError: It did not arrive in time.
        """
        if timeout_s is None:
            timeout_s = self.move_timeout_s(targets_mm, speed_mm_s)
        self.begin_move(targets_mm, speed_mm_s=speed_mm_s)
        return self.wait_idle(timeout_s)

    def wait_idle(self, timeout_s: float) -> dict[str, float]:
        """Wait until nothing moves; return all positions in mm.

        Raises:
            MoveFailedError: It stopped before its target.
            NoAnswerError: Still moving after `timeout_s`.
            LinkError: The device is gone.
        """
        self._require_open("wait_idle")
        self._do_wait_idle(timeout_s)
        return self.positions_mm()

    def positions_mm(self) -> dict[str, float]:
        """Read the positions of the axes, in mm.

        Raises:
            LinkError: No usable answer.
        """
        self._require_open("positions")
        return self._do_positions_mm()

    def plan_sweep(self, axis: str, from_mm: float, to_mm: float, speed_mm_s: float) -> Sweep:
        """Lay out a constant-speed sweep; nothing moves.

        Raises:
            OutOfRangeError: No such axis, no distance, too fast, or the run-up leaves the limits.
        """
        return plan_sweep(self.name, self._axis(axis), from_mm, to_mm, speed_mm_s)

    def prepare_sweep(self, sweep: Sweep, *, timeout_s: float | None = None) -> None:
        """Move to where the sweep begins and wait there.

        Raises:
            As `move_to`.
        """
        self.move_to({sweep.axis: sweep.begin_mm}, timeout_s=timeout_s)

    def begin_sweep(self, sweep: Sweep) -> None:
        """Start the sweep from `begin_mm`; `from_mm` is crossed `lead_s` later.

        Raises:
            As `begin_move`.
        """
        self.begin_move({sweep.axis: sweep.end_mm}, speed_mm_s=sweep.speed_mm_s)

    def stop(self) -> None:
        """Stop all axes; allowed in any state, any number of times.

        Raises:
            LinkError: The command did not reach the device.
        """
        self._require_open("stop")
        self._do_stop()

    def check_targets(self, targets_mm: Mapping[str, float]) -> dict[str, float]:
        """Return the quantised targets.

        Raises:
            OutOfRangeError: No such axis, or beyond the limits.
        """
        self._require_open("move")
        quantised = {}
        for name, target in targets_mm.items():
            axis = self._axis(name)
            value = axis.quantise_mm(target)
            _check_inside(self.name, axis, value, f"move {name} to {target:g} mm")
            quantised[name] = value
        return quantised

    def move_time_s(self, targets_mm: Mapping[str, float], speed_mm_s: float | None = None) -> float:
        """Return how long a move from the present position will take.

        Raises:
            OutOfRangeError: No such axis.
            LinkError: The position cannot be read.
        """
        here = self.positions_mm()
        return max(
            (
                trapezoid_time_s(target - here[name], speed_mm_s or axis.max_speed_mm_s, axis.acceleration_mm_s2)
                for name, target in targets_mm.items()
                for axis in (self._axis(name),)
            ),
            default=0.0,
        )

    def move_timeout_s(self, targets_mm: Mapping[str, float], speed_mm_s: float | None = None) -> float:
        """Return after how long such a move counts as failed: twice its computed time and a second.

        Raises:
            OutOfRangeError, LinkError: As `move_time_s`.
        """
        return 1.0 + 2.0 * self.move_time_s(targets_mm, speed_mm_s)

    def _axis(self, name: str) -> AxisInfo:
        if name not in self.info.axes:
            raise OutOfRangeError(self.name, f"axis {name!r}", allowed=", ".join(self.info.axes))
        return self.info.axes[name]

    def _axes(self, names: Sequence[str]) -> tuple[str, ...]:
        return tuple(self._axis(name).name for name in names) or tuple(self.info.axes)

    def _check_speed(self, names: Sequence[str], speed_mm_s: float | None) -> float:
        """Return the speed to use; None takes the slowest of the axes' highest speeds."""
        highest = min(self._axis(name).max_speed_mm_s for name in names)
        if speed_mm_s is None:
            return highest
        if not 0 < speed_mm_s <= highest * (1 + 1e-9):  # the tolerance admits a highest speed that was rounded
            raise OutOfRangeError(
                self.name,
                f"speed {speed_mm_s:g} mm/s",
                asked=f"move {', '.join(names)}",
                allowed=f"above 0 to {highest:g} mm/s",
            )
        return speed_mm_s

    @abstractmethod
    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        """Find the reference and wait for it."""

    @abstractmethod
    def _do_begin_move(self, targets_mm: Mapping[str, float], speed_mm_s: float) -> None:
        """Start a checked move."""

    @abstractmethod
    def _do_wait_idle(self, timeout_s: float) -> None:
        """Wait for the end of motion; raise MoveFailedError if it ended early."""

    @abstractmethod
    def _do_positions_mm(self) -> dict[str, float]:
        """Read all axes."""

    @abstractmethod
    def _do_stop(self) -> None:
        """Stop with deceleration, in any state."""


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
    if not 0 < speed_mm_s <= axis.max_speed_mm_s:
        raise OutOfRangeError(device, "no such speed", asked=asked, allowed=f"above 0 to {axis.max_speed_mm_s:g} mm/s")
    speed = axis.quantise_speed_mm_s(speed_mm_s)
    ramp = speed**2 / (2 * axis.acceleration_mm_s2)
    run_up = max(ramp * RAMP_MARGIN, ramp + axis.step_mm)
    direction = copysign(1.0, stop - start)
    begin = axis.quantise_mm(start - direction * run_up)
    end = axis.quantise_mm(stop + direction * run_up)
    for edge in (begin, end):
        _check_inside(device, axis, edge, asked + " with its run-up")
    lead_s = speed / axis.acceleration_mm_s2 + (abs(start - begin) - ramp) / speed
    return Sweep(axis.name, start, stop, speed, begin, end, lead_s)


def _check_inside(device: str, axis: AxisInfo, position_mm: float, asked: str) -> None:
    slack = axis.step_mm * 1e-6  # the rounding error of step counts in floating point
    if not axis.min_mm - slack <= position_mm <= axis.max_mm + slack:
        raise OutOfRangeError(
            device,
            f"{position_mm:g} mm is beyond the limits of axis {axis.name}",
            asked=asked,
            allowed=f"{axis.min_mm:g} to {axis.max_mm:g} mm",
        )
