"""The stage contract, to be run on every implementation through its twin.

Required fixtures: `bench`, a connected and referenced `StageBench`, closed in the end; `unreferenced`, one that is
neither connected nor referenced.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from gs2ci_drivers.failures import (
    DriverError,
    NoAnswerError,
    OutOfRangeError,
    PathError,
    ReferenceLostError,
    WrongStateError,
)
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.sweep_check import Path, SweepCheck


@dataclass
class StageBench:
    """A stage on its twin, with what a test needs to know of the twin.

    Args:
        stage: The driver.
        twin: The device's twin; its `positions_mm_at` returns the true positions of the axes, its `disturbances.add`
            hinders the next move as the device's own counter sees it (`gs2ci_sims.wires.disturbed`).
        clock: The world's, virtual.
        reopen: Opens the driver again after the twin was plugged in.
        cut_power: Cuts the twin's power and brings it back.
        move_text: Part of what the twin calls a move, for faults.
    """

    stage: Stage
    twin: Any
    clock: Any
    reopen: Callable[[], Stage]
    cut_power: Callable[[], object]
    move_text: str = "move"

    @property
    def axis(self) -> str:
        """Get the name of the axis that is moved."""
        return next(iter(self.stage.info.axes))

    def middle_mm(self) -> float:
        axis = self.stage.info.axes[self.axis]
        return (axis.min_mm + axis.max_mm) / 2

    def true_mm(self) -> float:
        return float(self.twin.positions_mm_at(self.clock.now_s())[self.axis])


def test_connecting_moves_nothing_and_is_idempotent(bench: StageBench) -> None:
    before = bench.true_mm()
    assert bench.stage.connect() == bench.stage.connect()
    bench.clock.sleep_s(5.0)
    assert bench.true_mm() == before


def test_what_it_is_is_not_known_before_it_is_connected(unreferenced: StageBench) -> None:
    with pytest.raises(WrongStateError, match=r"info: not connected.*call connect\(\) first"):
        _ = unreferenced.stage.info


def test_limits_and_steps_are_sane(bench: StageBench) -> None:
    for axis in bench.stage.info.axes.values():
        assert axis.min_mm < axis.max_mm
        assert 0 < axis.step_mm < 0.1
        assert axis.max_speed_mm_s > 0
        assert axis.acceleration_mm_s2 > 0


def test_a_move_arrives_and_reports_the_quantised_position(bench: StageBench) -> None:
    target = bench.middle_mm() + 3.14159265
    reached = bench.stage.move_to({bench.axis: target})
    step = bench.stage.info.axes[bench.axis].step_mm
    assert abs(reached[bench.axis] - target) <= step
    assert reached[bench.axis] / step == pytest.approx(round(reached[bench.axis] / step), abs=1e-6)
    assert bench.true_mm() == pytest.approx(reached[bench.axis], abs=1e-6)


def test_begin_move_returns_before_the_arrival_and_says_where_it_will_be(bench: StageBench) -> None:
    target = bench.middle_mm() + 10.0
    promised = bench.stage.begin_move({bench.axis: target}, speed_mm_s=5.0)
    assert bench.stage.status().moving
    assert abs(bench.true_mm() - target) > 1.0
    assert bench.stage.wait_idle(60.0)[bench.axis] == pytest.approx(promised[bench.axis])
    assert not bench.stage.status().moving


def test_two_axes_move_together(bench: StageBench) -> None:
    here = bench.stage.positions_mm()
    targets = {name: position + 2.0 + 0.5 * i for i, (name, position) in enumerate(here.items())}
    reached = bench.stage.move_to(targets)
    for name, target in targets.items():
        assert reached[name] == pytest.approx(target, abs=2 * bench.stage.info.axes[name].step_mm)


def test_a_move_takes_the_time_that_was_computed(bench: StageBench) -> None:
    target = {bench.axis: bench.stage.positions_mm()[bench.axis] + 8.0}
    computed_s = bench.stage.move_time_s(target, 4.0)
    begin_s = bench.clock.now_s()
    bench.stage.move_to(target, speed_mm_s=4.0)
    assert bench.clock.now_s() - begin_s == pytest.approx(computed_s, abs=0.5)


@pytest.mark.parametrize("beyond", [-1.0, 1.0])
def test_a_target_beyond_the_limits_is_refused_and_nothing_moves(bench: StageBench, beyond: float) -> None:
    axis = bench.stage.info.axes[bench.axis]
    before = bench.true_mm()
    target = axis.max_mm + beyond if beyond > 0 else axis.min_mm + beyond
    with pytest.raises(OutOfRangeError, match=r"stage0.*limits.*allowed") as caught:
        bench.stage.move_to({bench.axis: target})
    assert f"{axis.max_mm:g}" in str(caught.value)
    bench.clock.sleep_s(1.0)
    assert bench.true_mm() == before


@pytest.mark.parametrize("target", [float("nan"), float("inf"), -float("inf")])
def test_a_target_that_is_no_number_is_refused_and_nothing_moves(bench: StageBench, target: float) -> None:
    before = bench.true_mm()
    with pytest.raises(OutOfRangeError, match=r"stage0.*limits.*allowed"):
        bench.stage.begin_move({bench.axis: target})
    with pytest.raises(OutOfRangeError, match=r"stage0.*allowed"):
        bench.stage.plan_sweep(bench.axis, bench.middle_mm(), target, 1.0)
    bench.clock.sleep_s(1.0)
    assert bench.true_mm() == before


def test_an_unknown_axis_is_refused_with_those_there_are(bench: StageBench) -> None:
    with pytest.raises(OutOfRangeError, match=r"axis 'q'.*allowed: x, y"):
        bench.stage.move_to({"q": 1.0})


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e6])
def test_a_speed_it_cannot_keep_is_refused(bench: StageBench, speed: float) -> None:
    with pytest.raises(OutOfRangeError, match="speed"):
        bench.stage.begin_move({bench.axis: bench.middle_mm()}, speed_mm_s=speed)


def test_a_second_move_while_moving_is_refused_and_the_first_arrives(bench: StageBench) -> None:
    target = bench.middle_mm() + 5.0
    bench.stage.begin_move({bench.axis: target}, speed_mm_s=5.0)
    with pytest.raises(WrongStateError, match="moving"):
        bench.stage.begin_move({bench.axis: target - 1.0})
    assert bench.stage.wait_idle(60.0)[bench.axis] == pytest.approx(target, abs=0.01)


def test_stop_brings_it_to_rest_and_may_be_called_again(bench: StageBench) -> None:
    bench.stage.begin_move({bench.axis: bench.middle_mm() + 40.0}, speed_mm_s=5.0)
    bench.clock.sleep_s(0.5)
    bench.stage.stop()
    rest = bench.true_mm()
    bench.stage.stop()
    bench.clock.sleep_s(1.0)
    assert bench.true_mm() == rest
    assert abs(rest - (bench.middle_mm() + 40.0)) > 1.0


def test_it_can_be_homed_after_a_stop(bench: StageBench) -> None:
    bench.stage.begin_move({bench.axis: bench.middle_mm() + 40.0}, speed_mm_s=5.0)
    bench.clock.sleep_s(0.3)
    bench.stage.stop()
    bench.stage.home()
    assert bench.stage.status().referenced


def test_it_moves_again_after_a_stop(bench: StageBench) -> None:
    bench.stage.begin_move({bench.axis: bench.middle_mm() + 40.0}, speed_mm_s=5.0)
    bench.clock.sleep_s(0.3)
    bench.stage.stop()
    assert bench.stage.move_to({bench.axis: bench.middle_mm()})[bench.axis] == pytest.approx(
        bench.middle_mm(), abs=0.01
    )


@pytest.mark.parametrize("after_s", [0.01, 1.5])
def test_a_homing_that_is_interrupted_ends_at_rest_and_without_a_reference(
    unreferenced: StageBench, after_s: float
) -> None:
    stage, clock = unreferenced.stage, unreferenced.clock
    stage.connect()

    def interrupt() -> None:
        raise KeyboardInterrupt

    clock.after(after_s, interrupt)
    with pytest.raises(KeyboardInterrupt):
        stage.home()
    rest = unreferenced.true_mm()
    clock.sleep_s(1.0)
    assert unreferenced.true_mm() == rest
    assert not stage.status().moving
    with pytest.raises(ReferenceLostError):
        stage.move_to({unreferenced.axis: unreferenced.middle_mm()})
    stage.home()
    assert stage.status().referenced


def test_waiting_has_a_deadline(bench: StageBench) -> None:
    bench.stage.begin_move({bench.axis: bench.middle_mm() + 50.0}, speed_mm_s=1.0)
    begin_s = bench.clock.now_s()
    with pytest.raises(NoAnswerError, match="arrival"):
        bench.stage.wait_idle(2.0)
    assert 2.0 <= bench.clock.now_s() - begin_s < 3.0


def test_a_sweep_crosses_its_span_at_constant_speed_at_the_time_it_said(bench: StageBench) -> None:
    middle = bench.middle_mm()
    sweep = bench.stage.plan_sweep(bench.axis, middle, middle + 6.0, 8.0)
    bench.stage.prepare_sweep(sweep)
    bench.stage.begin_sweep(sweep)
    begun_s = bench.clock.now_s()
    bench.stage.wait_idle(30.0)
    twin, axis = bench.twin, bench.axis

    def at(since_from_s: float) -> float:
        return float(twin.positions_mm_at(begun_s + sweep.lead_s + since_from_s)[axis])

    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        since = share * sweep.cruise_s
        # The command travels for some ms before motion begins; 10 ms at 8 mm/s is 0.08 mm.
        assert at(since) == pytest.approx(sweep.position_mm(since), abs=0.08)
    h = 1e-3
    speeds = [(at(t + h) - at(t - h)) / (2 * h) for t in (0.05, 0.3, 0.5, 0.7)]
    assert speeds == pytest.approx([sweep.speed_mm_s] * 4, rel=1e-4)


def test_an_undisturbed_sweep_is_found_to_be_one(bench: StageBench) -> None:
    axis = bench.stage.info.axes[bench.axis]
    speed = max(0.5 * min(axis.max_speed_mm_s, 30.0), axis.min_speed_mm_s)
    path = swept(bench, bench.middle_mm(), bench.middle_mm() + 0.4 * speed, speed)
    assert path.positions > 10
    when_s = path.crossed_s + path.shift_s + path.sweep.cruise_s / 2
    assert float(bench.twin.positions_mm_at(when_s)[bench.axis]) == pytest.approx(
        path.position_mm(when_s), abs=path.error_mm
    )


@pytest.mark.parametrize("how", [{"pause_s": 0.06}, {"speed_factor": 1.5}])
def test_a_sweep_that_is_disturbed_on_its_way_is_found_to_be(bench: StageBench, how: dict[str, float]) -> None:
    with pytest.raises(PathError, match=r"stage0.*axis x left its path by.*allowed"):
        swept(bench, bench.middle_mm(), bench.middle_mm() + 4.0, 10.0, 0.4, how)


def test_a_sweep_that_begins_late_is_found_where_it_was(bench: StageBench) -> None:
    path = swept(bench, bench.middle_mm(), bench.middle_mm() + 4.0, 10.0, 0.0, {"pause_s": 0.05})
    assert path.shift_s == pytest.approx(0.05, abs=6e-3)


def swept(
    bench: StageBench,
    from_mm: float,
    to_mm: float,
    speed_mm_s: float,
    share: float = 0.0,
    how: dict[str, float] | None = None,
) -> Path:
    """Sweep, disturbed from a share of its time on, and return the path that the positions read meanwhile allow."""
    stage, clock = bench.stage, bench.clock
    sweep = stage.plan_sweep(bench.axis, from_mm, to_mm, speed_mm_s)
    stage.prepare_sweep(sweep)
    if how:
        bench.twin.disturbances.add(share, **how)
    stage.begin_sweep(sweep)
    check = SweepCheck(stage.name, stage.info.axes[bench.axis], sweep, clock.now_s() + sweep.lead_s)
    check.ask_until(clock.now_s() + 2 * sweep.lead_s + sweep.cruise_s, stage, clock)
    return check.path()


def test_a_speed_below_its_lowest_is_refused_with_a_sentence(bench: StageBench) -> None:
    axis = bench.stage.info.axes[bench.axis]
    if not axis.min_speed_mm_s:
        assert axis.keeps_mm_s(1e-9)
        return
    with pytest.raises(OutOfRangeError, match=r"slower than it can step.*allowed: "):
        bench.stage.plan_sweep(bench.axis, bench.middle_mm(), bench.middle_mm() + 1.0, axis.min_speed_mm_s / 2)


@pytest.mark.parametrize("after_s", [1e-3, 6e-3, 0.2])
def test_nothing_moves_after_a_stop_that_interrupted_a_move(bench: StageBench, after_s: float) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    bench.clock.after(after_s, interrupt)
    with pytest.raises(KeyboardInterrupt):
        bench.stage.move_to({bench.axis: bench.middle_mm() + 12.0})
    bench.stage.stop()
    rest = bench.true_mm()
    bench.clock.sleep_s(3.0)
    assert bench.true_mm() == rest
    assert not bench.stage.status().moving
    assert bench.stage.positions_mm()[bench.axis] == pytest.approx(rest, abs=0.01)


def test_a_move_whose_answer_is_lost_is_taken_back(bench: StageBench) -> None:
    bench.twin.faults.inject("serial.reply_lost", about=bench.move_text)
    with pytest.raises(NoAnswerError):
        bench.stage.move_to({bench.axis: bench.middle_mm() + 40.0})
    rest = bench.true_mm()
    bench.clock.sleep_s(3.0)
    assert bench.true_mm() == rest


def test_a_move_that_could_not_be_taken_back_says_that_it_stands(bench: StageBench) -> None:
    bench.twin.faults.inject("serial.unplugged", about=bench.move_text)
    with pytest.raises(DriverError, match="may still carry the move out: cut its power"):
        bench.stage.move_to({bench.axis: bench.middle_mm() + 40.0})


def test_a_sweep_whose_run_up_leaves_the_limits_is_refused(bench: StageBench) -> None:
    axis = bench.stage.info.axes[bench.axis]
    with pytest.raises(OutOfRangeError, match="run-up"):
        bench.stage.plan_sweep(bench.axis, axis.min_mm, axis.min_mm + 5.0, axis.max_speed_mm_s / 2)


def test_a_sweep_backwards_works_too(bench: StageBench) -> None:
    middle = bench.middle_mm()
    sweep = bench.stage.plan_sweep(bench.axis, middle, middle - 3.0, 4.0)
    assert sweep.begin_mm > sweep.from_mm > sweep.to_mm > sweep.end_mm
    bench.stage.prepare_sweep(sweep)
    bench.stage.begin_sweep(sweep)
    assert bench.stage.wait_idle(30.0)[bench.axis] == pytest.approx(sweep.end_mm, abs=0.01)


def test_a_sweep_of_no_length_is_refused(bench: StageBench) -> None:
    with pytest.raises(OutOfRangeError, match="no distance"):
        bench.stage.plan_sweep(bench.axis, bench.middle_mm(), bench.middle_mm(), 1.0)


def test_an_unreferenced_stage_does_not_move_until_it_is_homed(unreferenced: StageBench) -> None:
    stage = unreferenced.stage
    stage.connect()
    before = unreferenced.true_mm()
    assert not stage.status().referenced
    with pytest.raises(ReferenceLostError, match="home"):
        stage.move_to({unreferenced.axis: unreferenced.middle_mm()})
    assert unreferenced.true_mm() == before
    stage.home()
    assert stage.status().referenced
    stage.move_to({unreferenced.axis: unreferenced.middle_mm()})


def test_a_power_cycle_is_noticed_before_the_next_move(bench: StageBench) -> None:
    bench.cut_power()
    bench.clock.sleep_s(3.0)
    with pytest.raises(ReferenceLostError):
        bench.stage.move_to({bench.axis: bench.middle_mm()})


def test_close_may_be_called_twice_and_calls_after_it_are_refused(bench: StageBench) -> None:
    bench.stage.close()
    bench.stage.close()
    for call in (bench.stage.connect, bench.stage.positions_mm, bench.stage.stop, bench.stage.status):
        with pytest.raises(WrongStateError, match="closed"):
            call()


def test_a_new_session_finds_the_stage_where_the_last_one_left_it(bench: StageBench) -> None:
    reached = bench.stage.move_to({bench.axis: bench.middle_mm() + 1.0})
    limits = bench.stage.info
    bench.stage.close()
    bench.twin.faults.inject("serial.stale")
    again = bench.reopen()
    assert again.connect() == limits
    assert again.positions_mm() == reached
    again.close()


@pytest.mark.parametrize("moment", ["connect", "move", "wait", "stop", "status"])
def test_unplugging_is_a_typed_error_at_every_step(bench: StageBench, moment: str) -> None:
    if moment == "connect":
        bench.stage.close()
        bench.stage = bench.reopen()
    if moment == "wait":
        bench.stage.begin_move({bench.axis: bench.middle_mm() + 5.0})
    middle_mm = bench.middle_mm() if moment != "connect" else 0.0
    bench.twin.unplug()
    calls: dict[str, Callable[[], object]] = {
        "connect": bench.stage.connect,
        "move": lambda: bench.stage.move_to({"x": middle_mm}, timeout_s=5.0),
        "wait": lambda: bench.stage.wait_idle(5.0),
        "stop": bench.stage.stop,
        "status": bench.stage.status,
    }
    with pytest.raises(DriverError, match="stage0"):
        calls[moment]()
    bench.stage.close()
    bench.twin.plug_in()
    again = bench.reopen()
    again.connect()
    again.stop()
    again.close()
