"""Random interleavings of what happens to a stage: moves, stops, kills, reconnections, holds, resets, restarts.

Two promises are checked after every step. When `stop` has returned, or a move has ended with an error that does not say
that it stands, the carriage does not move until it is told to. And a stage that says it is referenced and at rest is
where it says: otherwise its position is said to be unknown.

`tests/drivers/test_interleavings.py` runs some, `python -m tests.benchmarks stage_interleavings` 10,000 of each stage.
"""

from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gs2ci_drivers.failures import DriverError, WrongStateError
from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.stage import STANDS, Stage
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.wires.grbl_build import GrblMachine
from gs2ci_sims.world import VirtualClock
from tests.drivers.grbl_builds import FLUIDNC, GRBLHAL
from tests.twins.grbl import GrblBuild, GrblTwin, OddMachine
from tests.twins.zaber import OddAxis, ZaberTwin

STEPS = 12
KNOWN_MM = 0.01
SHARES = st.floats(0.05, 0.95)
MOMENTS_S = st.one_of(st.none(), st.floats(0.0, 0.012), st.floats(0.0, 3.0))
SPEEDS_MM_S = st.sampled_from([None, 2.0, 10.0, 25.0])
QUIET = [HealthCheck.too_slow, HealthCheck.filter_too_much]


class Interrupted(BaseException):
    """Ctrl-C, or the end of a program."""


class Interleaving(RuleBasedStateMachine):
    """What happens to one stage; subclasses say which."""

    half_lines: tuple[bytes, ...] = ()

    def __init__(self) -> None:
        super().__init__()
        self.clock = VirtualClock()
        self.twin = self.make_twin()
        self.stage: Stage | None = None
        self.rest: dict[str, float] | None = None
        self.zero_mm = 0.0
        """Where the carriage is when it counts 0, as far as anybody can know."""

    def make_twin(self) -> Any:
        raise NotImplementedError

    def make_stage(self) -> Stage:
        raise NotImplementedError

    def restart(self) -> None:
        raise NotImplementedError

    def press(self, button: str) -> None:
        raise NotImplementedError

    def true_mm(self) -> dict[str, float]:
        found: dict[str, float] = self.twin.positions_mm_at(self.clock.now_s())
        return found

    @initialize()
    def connect(self) -> None:
        """Open a session; it may be refused, in which case there is none."""
        stage = self.make_stage()
        self.rest = None  # a session that finds it moving stops it
        try:
            stage.connect()
        except DriverError:
            stage.close()
            return
        self.stage = stage
        self.at_rest_from_now(stage)

    def at_rest_from_now(self, stage: Stage) -> None:
        """Note where it rests, if it says that it does."""
        try:
            moving = stage.status().moving
        except DriverError:
            moving = True
        self.rest = None if moving else self.true_mm()

    def during(self, call: Callable[[], object], after_s: float | None) -> None:
        """Do something of ours, interrupted after a time; note whether nothing may move from now on."""
        self.rest = None

        def interrupt() -> None:
            if not done:
                raise Interrupted

        done = False
        if after_s is not None:
            self.clock.after(after_s, interrupt)
        try:
            call()
        except WrongStateError:  # it moves, or is on hold: nothing was sent
            pass
        except DriverError as error:
            if STANDS not in str(error):
                self.rest = self.true_mm()
        except Interrupted:
            pass
        finally:
            done = True

    @precondition(lambda self: self.stage is not None)
    @rule(share=SHARES, speed=SPEEDS_MM_S, after_s=MOMENTS_S)
    def move(self, share: float, speed: float | None, after_s: float | None) -> None:
        """Move, to the end or until it is interrupted."""
        stage = self.session()
        axis = stage.info.axes["x"]
        target = axis.min_mm + share * (axis.max_mm - axis.min_mm)
        self.during(lambda: stage.move_to({"x": target}, speed_mm_s=speed), after_s)

    @precondition(lambda self: self.stage is not None)
    @rule(share=SHARES, speed=SPEEDS_MM_S, after_s=MOMENTS_S)
    def begin(self, share: float, speed: float | None, after_s: float | None) -> None:
        """Begin a move and do not wait for it."""
        stage = self.session()
        axis = stage.info.axes["x"]
        target = axis.min_mm + share * (axis.max_mm - axis.min_mm)
        self.during(lambda: stage.begin_move({"x": target}, speed_mm_s=speed), after_s)
        self.rest = None

    @precondition(lambda self: self.stage is not None)
    @rule(after_s=MOMENTS_S)
    def stop(self, after_s: float | None) -> None:
        """Stop; if that is interrupted, stop again."""
        stage = self.session()
        self.during(stage.stop, after_s)
        try:
            stage.stop()
        except DriverError:
            self.rest = None
        else:
            self.rest = self.true_mm()

    @precondition(lambda self: self.stage is not None)
    @rule(after_s=MOMENTS_S)
    def home(self, after_s: float | None) -> None:
        """Home, to the end or until it is interrupted."""
        self.during(self.session().home, after_s)

    @rule(half=st.integers(0, 9))
    def kill(self, half: int) -> None:
        """End the program at once, perhaps in the middle of a line."""
        if self.stage is not None:
            if half < len(self.half_lines):
                self.twin._receive(self.half_lines[half])
                if self.half_lines[half].endswith(b"\n"):  # a whole one, which it executes
                    self.rest = None
            self.twin._session = None
            self.stage = None

    @precondition(lambda self: self.stage is None)
    @rule()
    def reconnect(self) -> None:
        """Open a new session."""
        self.connect()

    @rule(button=st.sampled_from(["hold", "resume", "reset"]))
    def somebody(self, button: str) -> None:
        """Press a button at the device."""
        self.press(button)

    @rule()
    def brown_out(self) -> None:
        """Restart the device."""
        self.restart()
        self.clock.sleep_s(2.0)

    @rule(seconds=st.sampled_from([1e-3, 5e-3, 0.05, 1.0, 20.0]))
    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.clock.sleep_s(seconds)

    @invariant()
    def nothing_moves_after_a_stop(self) -> None:
        """Check the first promise."""
        if self.rest is not None:
            assert self.true_mm() == self.rest, "it moved after it was stopped"

    @invariant()
    def its_position_is_known_or_said_to_be_unknown(self) -> None:
        """Check the second promise."""
        if self.stage is None:
            return
        try:
            status = self.stage.status()
        except DriverError:
            return
        if status.referenced and not status.moving:
            now_s = self.clock.now_s()
            true_mm = self.twin.positions_mm_at(now_s)["x"]
            assert abs(status.positions_mm["x"] + self.zero_mm - true_mm) < KNOWN_MM, (
                "its position is wrong, and trusted"
            )

    def session(self) -> Stage:
        assert self.stage is not None
        return self.stage


class GrblInterleaving(Interleaving):
    """A GRBL controller on an AVR."""

    half_lines = (b"$J=G53 G21 G90 X-5", b"G1X-150F12", b"$", b"$J=G53 G21 G90 X-50 F600\n")
    machine = GrblMachine()

    def make_twin(self) -> GrblTwin:
        return GrblTwin(self.clock, self.machine)

    def make_stage(self) -> Stage:
        return GrblStage("stage0", self.twin.open(), self.clock, GrblOptions(axes=("x",)))

    def restart(self) -> None:
        self.twin.reboot()

    def press(self, button: str) -> None:
        self.twin.press(button)
        if button == "resume" and self.stage is None:
            self.rest = None  # of a program that was killed on hold


class UnlockedInterleaving(GrblInterleaving):
    """One without homing, whose greeting is the user's: it counts from where it was when a session began."""

    machine = OddMachine({22: 0}, build=GrblBuild(b"Welcome to room 12"))

    def at_rest_from_now(self, stage: Stage) -> None:
        super().at_rest_from_now(stage)
        self.zero_mm = self.true_mm()["x"] - stage.positions_mm()["x"]


class HalInterleaving(GrblInterleaving):
    """A grblHAL controller."""

    machine = OddMachine(build=GRBLHAL)


class FluidInterleaving(GrblInterleaving):
    """A FluidNC controller."""

    machine = OddMachine(build=FLUIDNC)


class ZaberInterleaving(Interleaving):
    """A Zaber device."""

    half_lines = (b"/01 1 57 move abs 300", b"/01 1 58 home", b"/")
    firmware = "7.28"

    def make_twin(self) -> ZaberTwin:
        return ZaberTwin(self.clock, OddAxis(max_steps=1000000, start_mm=20.0), firmware=self.firmware)

    def make_stage(self) -> Stage:
        return ZaberStage("stage0", self.twin.open(), self.clock, ZaberOptions(own_speed_mm_s={"x": 40.0}))

    def restart(self) -> None:
        self.twin.power_cycle()

    def press(self, button: str) -> None:
        if button == "hold":
            self.twin._end_motion(self.twin._axes, "NC")  # somebody turns the knob
        elif button == "reset":
            self.twin._end_motion(self.twin._axes, "FH")
        else:
            self.twin.release()


class OldZaberInterleaving(ZaberInterleaving):
    """One whose speed is a setting."""

    firmware = "6.28"


STAGES: dict[str, type[Interleaving]] = {
    "grbl": GrblInterleaving,
    "grbl without homing, another greeting": UnlockedInterleaving,
    "grblHAL": HalInterleaving,
    "FluidNC": FluidInterleaving,
    "zaber": ZaberInterleaving,
    "zaber before 7.25": OldZaberInterleaving,
}


def limits(examples: int, **more: Any) -> settings:
    """Return how many interleavings are tried."""
    return settings(
        max_examples=examples, stateful_step_count=STEPS, deadline=None, suppress_health_check=QUIET, **more
    )
