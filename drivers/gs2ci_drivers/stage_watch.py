"""The stage during a capture: its sweep, the positions that are read meanwhile, and the poses that follow from them.

Here: when positions are read and what they must show before a shot is delivered. Not here: the order of a capture's
steps (`acquisition`), what positions of a sweep allow (`sweep_check`).
"""

from math import sqrt

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import PathError
from gs2ci_drivers.plan import CapturePlan
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.sweep_check import Path, SweepCheck

SHORTEST_COMPARED_S = 0.05
"""Sweeps shorter than this end before the stage's position could be read."""
PATIENCE_S = 2.0
"""How long after its computed end a move may still be under way."""
STAMP_SLACK_S = 1e-3
"""By how much the time of an exposure and that of a position may differ: two clocks, two exchanges."""
LONGEST_LEARNT_S = 1.0
"""If a modulator appears to start later than this, the time stamps are wrong."""
REST_STEPS = 2.0
"""Steps by which an axis at rest may differ from itself: two roundings."""


class StageWatch:
    """The stage while one start of the modulator is served.

    Args:
        stage: The stage.
        plan: The capture.
        clock: The devices' clock.
    """

    def __init__(self, stage: Stage, plan: CapturePlan, clock: Clock) -> None:
        self._stage, self._plan, self._clock = stage, plan, clock
        self._rest_mm: dict[str, float] = {}
        self._check: SweepCheck | None = None
        self._watches = plan.sweep is not None and plan.sweep.cruise_s >= SHORTEST_COMPARED_S

    def prepare(self) -> None:
        """Move to where the sweep begins; note where all axes rest.

        Raises:
            DriverError: As `Stage.prepare_sweep`.
        """
        if self._plan.sweep is not None:
            self._stage.prepare_sweep(self._plan.sweep)
        self._rest_mm = self._stage.positions_mm()

    def begin(self) -> float:
        """Begin the sweep; return how long it takes until its speed is constant.

        Raises:
            DriverError: As `Stage.begin_sweep`.
        """
        sweep = self._plan.sweep
        if sweep is None:
            return 0.0
        self._stage.begin_sweep(sweep)
        axis = self._stage.info.axes[sweep.axis]
        self._check = SweepCheck(self._stage.name, axis, sweep, self._clock.now_s() + sweep.lead_s)
        return sweep.lead_s

    @property
    def error_mm(self) -> float | None:
        """Get by how much the positions of the present sweep may be off; None at rest."""
        return None if self._check is None else self._check.error_mm

    @property
    def exchange_s(self) -> float:
        """Get how long the last position took to read."""
        read = self._check.read if self._check is not None else []
        return read[-1][1] - read[-1][0] if read else 0.0

    def look(self) -> None:
        """Read the position once.

        Raises:
            DriverError: As `Stage.position_mm`.
        """
        if self._check is not None and self._watches:
            self._check.ask(self._stage, self._clock)

    def look_until(self, until_s: float) -> None:
        """Read positions as often as the line allows, until a time.

        Raises:
            DriverError: As `Stage.position_mm`.
        """
        if self._check is not None and self._watches:
            self._check.ask_until(until_s, self._stage, self._clock)

    def settle(self) -> None:
        """Wait for the end of the sweep; check that all that should not have moved is where it was.

        Raises:
            PathError: It is not.
            DriverError: As `Stage.wait_idle`.
        """
        sweep = self._plan.sweep
        if sweep is None:
            here_mm = self._stage.positions_mm()
        else:
            here_mm = self._stage.wait_idle(2 * sweep.lead_s + sweep.cruise_s + PATIENCE_S)
        for name, axis in self._stage.info.axes.items():
            off_mm = abs(here_mm[name] - self._rest_mm[name])
            allowed_mm = max(REST_STEPS * axis.step_mm + axis.report_mm, 2 * axis.window_mm)
            if (sweep is None or name != sweep.axis) and off_mm > allowed_mm:
                raise PathError(
                    self._stage.name,
                    f"axis {name} was at rest and moved by {off_mm:.4g} mm",
                    asked="capture",
                    allowed=f"{allowed_mm:.3g} mm",
                    remedy="look for a hand or a cable on the stage, and for another program that moves it",
                )

    def require_undisturbed(self) -> None:
        """Ask the device what went wrong with the path.

        Raises:
            PathError: Something did.
            LinkError: No usable answer.
        """
        faults = self._stage.path_faults() if self._check is not None else ()
        if faults:
            raise PathError(
                self._stage.name,
                "while masks were shown the stage reported " + ", ".join(faults),
                asked="sweep",
                remedy="look for an obstacle or a cable on the stage; lower the speed; allow a second attempt with "
                "`retries = 1` in [capture]",
            )

    def at_masks(self, first_s: float, seen_s: F64, shot: int, unsure_s: float) -> tuple[F64, F64]:
        """Return the position at each mask's central time, and its target, [N, K] in mm.

        Args:
            first_s: When the shot's first mask appeared.
            seen_s: Interval in which each mask was exposed, from then on, [N, 2].
            shot: Which shot of this start.
            unsure_s: By how much `first_s` may be off.

        Raises:
            PathError: The stage left its path, or its speed was not constant while masks were shown.
        """
        axes, centres_s = tuple(self._stage.info.axes), seen_s.mean(axis=1)
        measured = np.tile(np.array([self._rest_mm[axis] for axis in axes]), (len(centres_s), 1))
        target = measured.copy()
        travel = self._plan.settings.travel
        if self._check is None or travel is None:
            return measured, target
        path = self._check.path()
        if path.speed_factor != 1.0:
            self._stage.incidents.append(
                f"{self._stage.name}: axis {path.sweep.axis} moved at {path.speed_factor:.4f} times its planned speed, "
                "as with another clock; positions keep the planned one, which a calibration of the stage corrects"
            )
        self._require_constant_speed(path, first_s + float(seen_s[0, 0]), first_s + float(seen_s[-1, 1]), unsure_s)
        column, way = axes.index(path.sweep.axis), 1.0 if path.sweep.to_mm > path.sweep.from_mm else -1.0
        measured[:, column] = [path.position_mm(first_s + centre_s) for centre_s in centres_s]
        since_s = shot * self._plan.sequence.period_s + centres_s
        target[:, column] = travel.from_mm + way * path.sweep.speed_mm_s * since_s
        return measured, target

    def lead_s(self, present_s: float, measured: F64, target: F64) -> float:
        """Return how long before the travel the modulator is to be started next time, from this time's poses."""
        sweep = self._plan.sweep
        if sweep is None:
            return present_s
        column = tuple(self._stage.info.axes).index(sweep.axis)
        way = sweep.speed_mm_s * (1.0 if sweep.to_mm > sweep.from_mm else -1.0)
        late_s = float(measured[0, column] - target[0, column]) / way
        return min(max(present_s + late_s, 0.0), LONGEST_LEARNT_S)

    def _require_constant_speed(self, path: Path, begin_s: float, end_s: float, unsure_s: float) -> None:
        """Check that masks were seen at constant speed: in a ramp their poses would lie elsewhere."""
        outside_s = path.outside_s(begin_s, end_s)
        harmless_s = sqrt(2 * path.error_mm / max(path.sweep.accelerations_mm_s2))
        if outside_s > harmless_s + unsure_s + STAMP_SLACK_S:
            raise PathError(
                self._stage.name,
                f"axis {path.sweep.axis} moved {path.shift_s * 1e3:+.1f} ms after its plan: for {outside_s * 1e3:.1f} "
                "ms of the exposure its speed was not constant",
                asked=f"sweep {path.sweep.axis} from {path.sweep.from_mm:.4g} to {path.sweep.to_mm:.4g} mm",
                allowed=f"{harmless_s * 1e3:.1f} ms",
                remedy="look for what delays the stage or its line; allow a second attempt with `retries = 1` in "
                "[capture]",
            )
