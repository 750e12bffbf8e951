"""The machine of a GRBL controller: its states, motions, holds, doors, homing and alarms.

Sources: the head of `grbl`. Here: what happens without a line that says so. Not here: bytes and lines (`grbl`), builds
and their arithmetic (`grbl_build`).
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from math import hypot
from typing import NamedTuple

from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.disturbed import Disturbances
from gs2ci_sims.wires.grbl_build import (
    AXES,
    DEFAULTS,
    LEAST_FEED_MM_S,
    GrblMachine,
    stepped_rate_hz,
)
from gs2ci_sims.wires.serial_twin import SerialTwin
from gs2ci_sims.world import VirtualClock

ALARM_PAUSE_S = 0.5
CRITICAL_ALARMS = (1, 2)
SUSPENDED = ("Hold", "Door", "Sleep")
MOVING = ("Jog", "Run", "Home")
HOMING_CYCLES = ((2,), (0, 1))
SEARCH = 1.5
"""HOMING_AXIS_SEARCH_SCALAR of limits.c: by how many travels it looks for a switch."""


class Block(NamedTuple):
    """A motion as planned."""

    targets: Mapping[int, float]
    path_mm_s: float
    state: str


class GrblCore(SerialTwin):
    """The state machine below the lines.

    Args:
        clock: The world's clock.
        machine: The machine.
        faults: The faults to inject.
    """

    def __init__(self, clock: VirtualClock, machine: GrblMachine, faults: FaultSet | None) -> None:
        super().__init__(clock, faults)
        self._settings = DEFAULTS | dict(machine.settings)
        self._axes = [
            AxisMotion(machine.start_mm[i], self._settings[120 + i], machine.mechanics.get(name))
            for i, name in enumerate(AXES)
        ]
        self.disturbances = Disturbances(clock, self.faults)
        self._state = "Idle" if machine.homed or not self._locks() else "Alarm"
        self._ajar = False
        self._deaf_until_s = 0.0
        self._awaits_reset = False
        self._generation = 0
        self._life = 0  # counts restarts: what was to happen before one does not happen after it
        self._blocks: list[Block] = []  # planned and not yet begun
        self._present: Block | None = None
        self._early_reports = 0

    def positions_mm_at(self, when_s: float) -> dict[str, float]:
        """Return the true positions of the carriages."""
        return {name: axis.true_position_at(when_s) for name, axis in zip(AXES, self._axes, strict=False)}

    def open_door(self) -> None:
        """Open the safety door, on a build that has one."""
        self._ajar = True
        self._suspend("Door")

    def release(self) -> None:
        """Do what a user does after a stop: close the door, release the hold."""
        self._ajar = False
        self._realtime(ord("~"))

    @abstractmethod
    def _pump(self) -> None:
        """Read the next line."""

    @abstractmethod
    def _answer(self, reply: str, about: str) -> None:
        """End a line with its reply."""

    @abstractmethod
    def _greet(self) -> None:
        """Print the greeting of a restart."""

    @abstractmethod
    def _forget(self) -> None:
        """Begin anew."""

    @abstractmethod
    def reboot(self) -> None:
        """Restart."""

    def _locks(self) -> bool:
        return bool(self._settings[22])

    def _travel_mm(self, i: int) -> tuple[float, float]:
        """Return the ends of an axis' travel."""
        return -self._settings[130 + i], 0.0

    def _homed_mm(self, i: int) -> float:
        """Return what an axis counts after homing (limits.c, limits_go_home), pulled off its switch."""
        pulloff_mm = self._settings[27]
        return pulloff_mm - self._settings[130 + i] if self._homes_down(i) else -pulloff_mm

    def _homes_down(self, i: int) -> bool:
        return bool(int(self._settings[23]) >> i & 1)

    def _in_this_life(self, delay_s: float, action: Callable[[], None]) -> None:
        life = self._life

        def act() -> None:
            if life == self._life:
                action()

        self.clock.after(delay_s, act)

    def _later(self, when_s: float, action: Callable[[], None]) -> None:
        """Schedule an action that a newer motion, a stop or a reset cancels."""
        generation = self._generation

        def act() -> None:
            if generation == self._generation:
                action()

        self.clock.at(when_s, act)

    def _moving(self) -> bool:
        return any(axis.moving_at(self.clock.now_s()) for axis in self._axes)

    def _suspend(self, state: str) -> None:
        """Hold, or stop for a door: a jog is cancelled by either, and a hold leaves it Idle."""
        if self._state == "Jog":
            self._cancel("Idle" if state == "Hold" else state)
        elif self._state == "Run" and self._moving():
            self._state = state
            self._generation += 1
            for axis in self._axes:
                axis.stop(self.clock.now_s())
        elif self._state in ("Idle", "Run") or (self._state == "Hold" and state == "Door"):
            self._state = state

    def _resume(self) -> None:
        if self._state not in ("Hold", "Door") or self._moving() or self._ajar:
            return
        if self._present is not None:
            self._blocks.insert(0, self._present)
        self._next_block()
        self._pump()

    def _cancel(self, state: str) -> None:
        """Cancel a jog: brake, drop what is planned, and only then be in another state."""
        self._generation += 1
        self._blocks.clear()
        ends_s = max(axis.stop(self.clock.now_s()) for axis in self._axes)

        def rest() -> None:
            self._present, self._state = None, "Door" if self._ajar else state

        self._later(ends_s, rest)

    def _plan(self, values: Mapping[str, float], path_mm_s: float, state: str) -> None:
        self._blocks.append(Block({"XYZ".index(letter): value for letter, value in values.items()}, path_mm_s, state))
        if self._state == "Idle":
            self._next_block()

    def _next_block(self) -> None:
        self._present = self._blocks.pop(0) if self._blocks else None
        if self._present is None:
            self._state = "Idle"
            return
        now_s, self._state = self.clock.now_s(), self._present.state
        ends_s = self._begin(self._present, now_s)
        self._generation += 1
        self._later(ends_s, self._rest)
        moving = [axis for axis in self._axes if axis.moving_at(now_s)]
        self.disturbances.schedule(moving, ends_s, "$J=" if self._state == "Jog" else "G1")
        if self.faults.take("grbl.early_idle"):
            self._early_reports = 2
        for kind, action in (
            ("grbl.hard_limit", lambda: self._alarm(1)),
            ("grbl.reset_moving", self._soft_reset),
            ("grbl.power_cycle", self.reboot),
            ("grbl.door", self.open_door),
            ("grbl.hold", lambda: self._suspend("Hold")),
            ("grbl.jog_cancelled", lambda: self._cancel("Idle")),
        ):
            if self.faults.take(kind):
                self._later((now_s + ends_s) / 2, action)

    def _begin(self, block: Block, now_s: float) -> float:
        """Begin a motion at the speed that the planner and the step timer make of the one asked for."""
        distances = {i: target - self._axes[i].position_at(now_s) for i, target in block.targets.items()}
        path_mm = hypot(*distances.values())
        if not path_mm:
            return now_s
        path_mm_s = max(block.path_mm_s, LEAST_FEED_MM_S)
        for i, distance in distances.items():  # no axis beyond its own rate
            if distance:
                path_mm_s = min(path_mm_s, self._settings[110 + i] / 60 * path_mm / abs(distance))
        steps_per_mm = max(abs(d) * self._settings[100 + i] for i, d in distances.items()) / path_mm
        path_mm_s = self._stepped_hz(path_mm_s * steps_per_mm) / steps_per_mm
        ends_s = now_s
        for i, distance in distances.items():
            if distance:
                target = round(block.targets[i] * self._settings[100 + i]) / self._settings[100 + i]
                speed_mm_s = path_mm_s * abs(distance) / path_mm
                ends_s = max(ends_s, self._axes[i].move_to(target, speed_mm_s, now_s))
        return ends_s

    def _stepped_hz(self, rate_hz: float) -> float:
        return stepped_rate_hz(rate_hz)

    def _rest(self) -> None:
        if self._moving():  # it was hindered
            self._later(max(axis.ends_s for axis in self._axes), self._rest)
            return
        self._next_block()

    def _soft_reset(self) -> None:
        if self._state == "Home":
            self._alarm(6)
        elif self._moving():
            self._alarm(3)
        else:
            self._forget()
            self._state = "Alarm" if self._state in ("Alarm", "Sleep") else "Door" if self._ajar else "Idle"
            self._greet()

    def _alarm(self, number: int) -> None:
        """Stop at once; the processor stands still for `$1` ms, says the alarm and stands still again."""
        now_s = self.clock.now_s()
        homing, self._state = self._state == "Home", "Alarm"
        self._forget()
        for axis in self._axes:
            axis.halt(now_s)
        lock_s = self._settings[1] / 1000
        self._deaf_until_s = now_s + lock_s + ALARM_PAUSE_S
        self._awaits_reset = number in CRITICAL_ALARMS
        self._in_this_life(lock_s, lambda: self._reply(f"ALARM:{number}\r\n".encode("ascii"), "alarm"))

        def after() -> None:
            if self._awaits_reset:
                self._reply(b"[MSG:Reset to continue]\r\n", "alarm")
                return
            if homing:
                self._reply(b"ok\r\n", "alarm")
            self._greet()

        self._in_this_life(lock_s + ALARM_PAUSE_S, after)

    def _home(self, text: str) -> None:
        if not self._settings[22]:
            self._answer("error:5", text)
            return
        cycles = self._cycles(text)
        if cycles is None:
            self._answer("error:3", text)
            return
        self._state = "Home"
        self._generation += 1
        missing = self.faults.take("grbl.homing_fails") is not None
        self._homing_cycle([[i for i in cycle if i < len(self._axes)] for cycle in cycles], text, missing=missing)

    def _cycles(self, text: str) -> Sequence[Sequence[int]] | None:
        """Return which axes a command homes together, one group after another; None if it is no such command."""
        return HOMING_CYCLES if text == "$H" else None

    def _homing_cycle(self, cycles: list[list[int]], text: str, *, missing: bool) -> None:
        """Seek the switches of one cycle, pull off, approach slowly, pull off; then the next cycle."""
        cycle = cycles.pop(0)
        seek_mm_s, feed_mm_s = self._settings[25] / 60, self._settings[24] / 60
        pause_s, pulloff_mm = self._settings[26] / 1000, self._settings[27]

        def go(legs: list[tuple[bool, float]]) -> None:
            if not legs:
                end()
                return
            (onto, speed_mm_s), now_s = legs[0], self.clock.now_s()
            ends_s = now_s
            for i in cycle:
                way = -1.0 if self._homes_down(i) else 1.0
                counted = self._axes[i].counted_mm(self._homed_mm(i) + way * pulloff_mm)
                if onto and missing:
                    counted = self._axes[i].position_at(now_s) + way * SEARCH * self._settings[130 + i]
                target = counted if onto else counted - way * pulloff_mm
                ends_s = max(ends_s, self._axes[i].move_to(target, speed_mm_s, now_s))
            self._later(ends_s + pause_s, lambda: self._alarm(9) if onto and missing else go(legs[1:]))

        def end() -> None:
            for i in cycle:
                self._axes[i].set_position(self._homed_mm(i), self.clock.now_s())
            if cycles:
                self._homing_cycle(cycles, text, missing=False)
                return
            self._state, self._present = "Idle", None
            if text == "$H":
                self._start_up()
            self._answer("ok", text)

        go([(True, seek_mm_s), (False, seek_mm_s), (True, feed_mm_s), (False, seek_mm_s)])

    def _start_up(self) -> None:
        """Execute the startup lines; there are none."""
