"""What Zaber devices do where one would guess otherwise: each case of `manners/zaber.toml`."""

import pytest

from gs2ci.core.mechanics import Mechanics
from gs2ci_drivers.failures import MoveFailedError, ReferenceLostError
from gs2ci_drivers.sweep_check import SweepCheck
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.world import VirtualClock
from tests.twins.zaber import OddAxis, ZaberTwin

COUNT_MM = 0.0001


def make(axis=None, **twin):
    clock = VirtualClock()
    twin = ZaberTwin(clock, axis or OddAxis(microstep_mm=COUNT_MM), **twin)
    stage = ZaberStage("stage0", twin.open(), clock, ZaberOptions(axes={"x": 1}, microstep_mm={"x": COUNT_MM}))
    stage.connect()
    return clock, twin, stage


def sweep(stage, clock):
    planned = stage.plan_sweep("x", 70.0, 71.0, 12.5)
    stage.prepare_sweep(planned)
    stage.begin_sweep(planned)
    stage.wait_idle(10.0)
    return stage.path_faults()


def test_an_axis_that_stalls_and_recovers_in_a_sweep_is_told_of_though_it_arrives():
    clock, twin, stage = make()
    assert sweep(stage, clock) == ()
    twin.faults.inject("zaber.recovers", skip=1)
    assert sweep(stage, clock) == ("WS (stalled and recovered)",)


def test_what_it_remembers_of_an_earlier_stall_is_cleared_before_a_sweep():
    clock, twin, stage = make()
    twin.faults.inject("zaber.recovers")
    stage.move_to({"x": 60.0})  # it arrived, which is all that was asked
    assert any("WS" in text for text in stage.status().warnings)
    assert sweep(stage, clock) == ()


def kept_path(stage, clock, twin):
    """Return by how much a sweep's true positions leave a line of the planned speed while masks are on show, mm."""
    planned = stage.plan_sweep("x", 70.0, 71.0, 25.0)
    stage.prepare_sweep(planned)
    stage.begin_sweep(planned)
    crossed_s = clock.now_s() + planned.lead_s
    check = SweepCheck("stage0", stage.info.axes["x"], planned, crossed_s)
    check.ask_until(crossed_s + planned.cruise_s + planned.ramps_s[1], stage, clock)
    stage.wait_idle(10.0)
    path = check.path()
    shown = [crossed_s + path.shift_s + planned.cruise_s * share / 50 for share in range(51)]
    off_mm = [twin.positions_mm_at(when_s)["x"] - path.position_mm(when_s) for when_s in shown]
    return max(off_mm) - min(off_mm)


# Accelerations in data of 610 mm/s^2 per thousand: ramps of 25 mm/s take 24 ms, or 0.3 mm.
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"deceleration": 400},
        {"deceleration": 5000},
        {"rounding_ms": 25.0},
        {"deceleration": 600, "rounding_ms": 60.0},
    ],
)
def test_ramps_that_another_program_made_gentler_lie_outside_the_masks(settings):
    axis = OddAxis(microstep_mm=COUNT_MM, acceleration=1720, **settings)
    clock, twin, stage = make(axis)
    assert kept_path(stage, clock, twin) < 2e-3
    found = stage.info.axes["x"]
    ends = [found.acceleration_mm_s2, found.braking_mm_s2]
    assert ends == pytest.approx([one * 1e4 / 1.6384 * COUNT_MM for one in (1720, settings.get("deceleration", 1720))])
    assert stage.info.axes["x"].rounding_s == pytest.approx(settings.get("rounding_ms", 0.0) * 1e-3)


def test_firmware_with_one_acceleration_for_both_ends_is_asked_for_that():
    axis = OddAxis(microstep_mm=COUNT_MM, rounding_ms=None)
    _, _, stage = make(axis, firmware="6.05")
    assert stage.info.axes["x"].acceleration_mm_s2 == pytest.approx(1720 * 1e4 / 1.6384 * COUNT_MM)
    assert stage.info.axes["x"].rounding_s == 0.0


@pytest.mark.parametrize("seconds", [0.0, 0.123, 0.7])
def test_a_servo_axis_that_moves_by_some_counts_at_rest_has_arrived(seconds):
    clock, _, stage = make(OddAxis(microstep_mm=COUNT_MM, settle_um=2.0, restless_steps=10))
    clock.sleep_s(seconds)
    assert stage.info.axes["x"].window_mm == pytest.approx(0.002)
    assert stage.move_to({"x": 60.0})["x"] == pytest.approx(60.0, abs=0.002)


def test_an_axis_that_rests_beyond_its_own_tolerance_has_not():
    _, twin, stage = make(OddAxis(microstep_mm=COUNT_MM, settle_um=2.0))
    twin.faults.inject("zaber.slip", value=0.003)
    with pytest.raises(MoveFailedError, match="short of its target"):
        stage.move_to({"x": 60.0})


def test_the_twin_lists_the_flags_that_it_clears():
    _, twin, stage = make()
    twin._axes[0].flags.add("NI")
    assert stage._link.command(1, "warnings clear").data == "01 NI"
    assert stage._link.command(1, "warnings").data == "00"


@pytest.mark.parametrize(("flag", "words"), [("WR", "as after a loss of power"), ("WH", "its position is known")])
def test_a_missing_reference_is_told_in_the_words_of_its_flag(flag, words):
    _, twin, stage = make()
    twin._axes[0].flags.add(flag)
    with pytest.raises(ReferenceLostError, match=words):
        stage.move_to({"x": 60.0})
    twin._axes[0].flags.clear()
    stage.begin_move({"x": 60.0})
    twin._axes[0].flags.add(flag)
    with pytest.raises(ReferenceLostError, match=words):
        stage.wait_idle(10.0)


def test_the_carriage_stands_still_when_the_power_fails_and_homing_finds_its_sensor():
    clock, twin, stage = make()
    before = twin.positions_mm_at(clock.now_s())
    twin.power_cycle()
    assert twin.positions_mm_at(clock.now_s()) == before
    assert stage.positions_mm()["x"] == 0.0
    stage.home()
    assert twin.positions_mm_at(clock.now_s())["x"] == pytest.approx(0.0, abs=1e-9)
    assert stage.move_to({"x": 60.0})["x"] == pytest.approx(twin.positions_mm_at(clock.now_s())["x"])


def test_steps_that_a_motor_without_encoder_loses_change_no_report():
    clock, twin, stage = make(OddAxis(microstep_mm=COUNT_MM, mechanics=Mechanics(slip_mm=0.5, seed=1)))
    assert stage.move_to({"x": 60.0})["x"] == pytest.approx(60.0)
    assert abs(twin.positions_mm_at(clock.now_s())["x"] - 60.0) > 0.05
