"""The motion stage's interface: named axes in millimetres.

The public methods check and keep the order of calls; a driver writes only the private `_do_*` hooks.

Promises that every implementation keeps and `tests/contracts/test_stage.py` tests: connecting moves nothing and
resets nothing that answers; homing happens only on request, and ends at rest if it is interrupted; a target beyond the
limits is refused, never clipped; positions are in mm and the quantised value is returned; a move that did not reach its
target is an error; a move that was not answered, or whose wait failed, is taken back; `stop` may be called in any state
and more than once, and returns when the stage is at rest and nothing is pending; `close` may be called twice and does
not stop a move.

Here: the records, the abstract class. Not here: axes and the sweep's arithmetic (`axis`), whether a sweep went as
planned (`sweep_check`), bytes (each driver's package).
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from gs2ci_drivers.axis import TOO_SLOW, AxisInfo, Sweep, check_inside, plan_sweep, trapezoid_time_s
from gs2ci_drivers.device import Device
from gs2ci_drivers.failures import (
    HOME_COMMAND,
    DeviceFaultError,
    DriverError,
    OutOfRangeError,
    ReferenceLostError,
    UnsupportedError,
    WrongStateError,
)

HOME_S = 120.0
"""The least time that a stage gets for its homing."""
STANDS = "the stage may still carry the move out: cut its power before you reach in"


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
        unreferenced: Why it has no reference position, in the device's own terms.
    """

    moving: bool
    referenced: bool
    positions_mm: Mapping[str, float] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unreferenced: str = ""


class Stage(Device[StageInfo, StageStatus]):
    """A device that moves the camera.

    `close` does not stop a move.
    """

    def home(self, axes: Sequence[str] = (), *, timeout_s: float | None = None) -> dict[str, float]:
        """Find the reference of these axes (all when none are named); return all positions in mm.

        If it fails or is interrupted, the stage is stopped.

        Args:
            axes: Names of the axes.
            timeout_s: Deadline; None takes `HOME_S`, or longer where the device's own speed of homing is lower.

        Raises:
            OutOfRangeError: No such axis.
            NoAnswerError: Not done in time.
            MoveFailedError: The reference was not found.
        """
        names = self._axes(axes)
        try:
            if timeout_s is None:
                timeout_s = max(HOME_S, self._do_home_time_s(names))
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
            OutOfRangeError: No such axis, beyond the limits, too fast or too slow; nothing moved.
            WrongStateError: It moves already.
            ReferenceLostError: The stage has lost its reference position; home it first.
            RefusedError: The device did not accept the command.
            LinkError: It did not answer; the stage was stopped, or the error says that the move may still come.
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
                [status.unreferenced or "no reference position"],
                remedy=f"home the stage: `{HOME_COMMAND}` (it will move to its reference switch)",
            )
        try:
            self._do_begin_move(quantised, speed)
        except BaseException as error:  # it may have been accepted all the same, or by one axis of two
            self._take_back(error)
            raise
        return quantised

    def move_to(
        self, targets_mm: Mapping[str, float], *, speed_mm_s: float | None = None, timeout_s: float | None = None
    ) -> dict[str, float]:
        """Move and wait for the arrival; return all positions in mm. If it fails, the stage is stopped.

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
        try:
            return self.wait_idle(timeout_s)
        except BaseException as error:
            self._take_back(error)
            raise

    def wait_idle(self, timeout_s: float) -> dict[str, float]:
        """Wait until nothing moves; return all positions in mm. A move that lasts longer goes on.

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

    def position_mm(self, axis: str) -> float:
        """Read the position of one axis, in mm: the quickest way to see where it is while it moves.

        Raises:
            OutOfRangeError: No such axis.
            LinkError: No usable answer.
        """
        self._require_open("position")
        return self._do_position_mm(self._axis(axis).name)

    def path_faults(self) -> tuple[str, ...]:
        """Ask what went wrong with the path since `begin_sweep`, as far as the device tells, in its own terms.

        Raises:
            LinkError: No usable answer.
        """
        self._require_open("path faults")
        return self._do_path_faults()

    @property
    def sample_gap_s(self) -> float:
        """Get the least time between two positions that are read while it moves."""
        return 0.0

    def plan_sweep(self, axis: str, from_mm: float, to_mm: float, speed_mm_s: float) -> Sweep:
        """Lay out a constant-speed sweep; nothing moves.

        Raises:
            OutOfRangeError: No such axis, no distance, too fast, too slow, or the run-up leaves the limits.
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
        self._require_open("sweep")
        self._do_forget_path_faults()
        self.begin_move({sweep.axis: sweep.end_mm}, speed_mm_s=sweep.speed_mm_s)

    def stop(self) -> None:
        """Stop all axes; when it returns, they are at rest and nothing is pending.

        Allowed in any state, any number of times.

        Raises:
            LinkError: The command did not reach the device, or it still moves.
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
            check_inside(self.name, axis, value, f"move {name} to {target:g} mm")
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
        axes = [self._axis(name) for name in names]
        slowest = min(axes, key=lambda axis: axis.max_speed_mm_s)
        if speed_mm_s is None:
            return slowest.max_speed_mm_s
        for axis in (slowest, *axes):
            if not axis.keeps_mm_s(speed_mm_s):
                raise OutOfRangeError(
                    self.name,
                    f"speed {speed_mm_s:g} mm/s" + (TOO_SLOW if 0 < speed_mm_s < axis.min_speed_mm_s else ""),
                    asked=f"move {', '.join(names)}",
                    allowed=axis.speeds,
                )
        return speed_mm_s

    def _take_back(self, error: BaseException) -> None:
        """Stop, so that a move that failed does not run later; if that fails too, the error says what may happen.

        Not after errors that say that nothing was sent, or that the stage has stopped by itself.
        """
        if isinstance(error, WrongStateError | UnsupportedError | DeviceFaultError):
            return
        try:
            self._do_stop()
        except DriverError:
            if isinstance(error, DriverError):
                error.remedy = f"{error.remedy}; {STANDS}" if error.remedy else STANDS

    @abstractmethod
    def _do_home(self, axes: tuple[str, ...], timeout_s: float) -> None:
        """Find the reference and wait for it."""

    def _do_home_time_s(self, axes: tuple[str, ...]) -> float:
        """Return how long homing may take, by its speed; overridden where the device tells that."""
        return 0.0

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
        """Stop with deceleration, in any state; return at rest with nothing pending."""

    def _do_position_mm(self, axis: str) -> float:
        """Read one axis; overridden where that is quicker than reading all."""
        return self._do_positions_mm()[axis]

    def _do_forget_path_faults(self) -> None:
        """Clear what the device remembers of earlier paths; overridden where it remembers any."""

    def _do_path_faults(self) -> tuple[str, ...]:
        """Read what the device remembers of the path; overridden where it remembers any."""
        return ()
