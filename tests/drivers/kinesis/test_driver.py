"""The Kinesis driver on its twin: what Thorlabs' controllers do where one would guess otherwise."""

from dataclasses import replace

import pytest
from pydantic import ValidationError

from gs2ci_drivers.failures import (
    BadReplyError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    UnsupportedError,
)
from gs2ci_drivers.kinesis.driver import KinesisStage
from gs2ci_drivers.kinesis.options import KinesisOptions
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.kinesis import BUILT, AptAxis, KinesisTwin
from gs2ci_sims.world import VirtualClock
from tests.drivers.scripted import ScriptedPort


def make(twin_axes=None, options=None, **twin):
    clock = VirtualClock()
    device = KinesisTwin(clock, twin_axes or {"x": BUILT["MTS50-Z8"]}, FaultSet(), **twin)
    return clock, device, KinesisStage("stage0", device.open(), clock, options)


def test_a_cube_says_what_it_is_and_its_axis_is_the_stages():
    _, _, stage = make()
    info = stage.connect()
    assert (info.model, info.serial, info.firmware) == ("Thorlabs KDC101", "27250001", "1.2.3")
    axis = info.axes["x"]
    assert (axis.min_mm, axis.max_mm, axis.max_speed_mm_s) == (0.0, 50.0, 2.4)
    assert axis.step_mm == pytest.approx(1 / 34554.96)
    assert axis.acceleration_mm_s2 == pytest.approx(4.5, rel=1e-3)


def test_a_stage_with_other_counts_on_its_label_goes_where_it_should():
    built = AptAxis(34304.0, 50.0, 2.4, 4.5, 2048 / 6e6, 25.0)
    clock, twin, right = make({"x": built}, KinesisOptions(counts_per_mm={"x": 34304.0}))
    right.connect()
    right.move_to({"x": 40.0})
    assert twin.positions_mm_at(clock.now_s())["x"] == pytest.approx(40.0, abs=1e-4)
    clock, twin, wrong = make({"x": built})
    wrong.connect()
    wrong.move_to({"x": 40.0})
    assert twin.positions_mm_at(clock.now_s())["x"] == pytest.approx(40.0 * 34554.96 / 34304.0, abs=1e-3)


def test_power_that_fails_in_a_move_loses_the_reference_and_is_told():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("kinesis.power_cycle")
    with pytest.raises(ReferenceLostError, match=r"lost power.*--home"):
        stage.move_to({"x": 30.0})
    assert not stage.status().referenced
    stage.home()
    assert stage.move_to({"x": 30.0})["x"] == pytest.approx(30.0, abs=1e-4)


@pytest.mark.parametrize(
    ("fault", "bit", "said", "stays"),
    [
        ("kinesis.stall", 0, "motion error", True),
        ("kinesis.beside", 0, "short", False),
        ("kinesis.wheel", 0, "wheel", False),
        ("kinesis.status_bit", 0x4, "software limit", False),
        ("kinesis.status_bit", 0x8, "software limit", False),
        ("kinesis.status_bit", 0x8000, "could not carry a command out", False),
        ("kinesis.status_bit", 0x10000, "enables the motor, or a position error", False),
        ("kinesis.status_bit", 0x20000, "too hot", True),
        ("kinesis.status_bit", 0x40000, "supply's voltage", True),
        ("kinesis.status_bit", 0x80000, "commutation", True),
        ("kinesis.status_bit", 0x2000000, "encoder", True),
        ("kinesis.status_bit", 0x4000000, "current was too high", True),
        ("kinesis.status_bit", 0x8000000, "current is drawn", True),
        ("kinesis.status_bit", 0x10000000, "short", False),  # power is good
    ],
)
def test_a_move_that_ends_elsewhere_is_an_error(fault, bit, said, stays):
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject(fault, value=bit)
    with pytest.raises(MoveFailedError, match=said):
        stage.move_to({"x": 30.0})
    assert stage.status().referenced
    assert bool(stage.status().faults) == stays


def test_a_homing_that_finds_nothing_is_an_error():
    clock, twin, stage = make(homed=False)
    stage.connect()
    clock.after(2.0, lambda: twin._stop(0x50, twin._axes["x"], at_once=True))
    with pytest.raises(MoveFailedError, match="without a reference"):
        stage.home()


def test_a_homing_that_is_slow_by_the_controllers_own_setting_is_waited_for():
    built = replace(BUILT["LTS300"], start_mm=290.0, home_mm_s=2.0)
    clock, _, stage = make({"x": built}, KinesisOptions(stages={"x": "LTS300"}), homed=False)
    stage.connect()
    assert stage.home() == {"x": 0.0}
    assert clock.now_s() > 145.0
    stage.move_to({"x": 290.0})
    with pytest.raises(NoAnswerError, match="home: arrival"):
        stage.home(timeout_s=120.0)


def test_a_channel_without_a_speed_of_homing_gets_one():
    clock, twin, stage = make({"x": replace(BUILT["MTS25-Z8"], home_mm_s=0.0)}, homed=False)
    stage.connect()
    twin._message(0x0443, 1, 0, 0x50, b"")
    clock.sleep_s(60.0)
    assert not stage.status().referenced, "at this speed it never moves"
    assert stage.home() == {"x": 0.0}
    assert stage.incidents == ["stage0: axis x had no speed of homing, and got 1.2 mm/s"]


def test_end_of_move_messages_are_not_relied_on():
    _, twin, stage = make()
    twin.suspend_end_of_move_messages()
    stage.connect()
    assert stage.move_to({"x": 26.0})["x"] == pytest.approx(26.0, abs=1e-4)


def test_updates_of_another_program_are_switched_off_and_never_taken_for_answers():
    clock, twin, stage = make()
    twin.begin_updates()
    clock.sleep_s(0.35)
    stage.connect()
    assert twin._updates_left == 0
    twin.begin_updates()
    stage.begin_move({"x": 26.0})
    for _ in range(20):
        assert stage.positions_mm()["x"] == pytest.approx(twin.positions_mm_at(clock.now_s())["x"], abs=0.02)
        clock.sleep_s(0.03)
    stage.wait_idle(10.0)


def test_updates_end_by_themselves_unless_they_are_acknowledged():
    clock, twin, _ = make()
    twin.begin_updates()
    clock.sleep_s(20.0)
    assert twin._updates_left == 0
    assert len(twin._outgoing) == 50 * 20


def test_the_speed_that_was_found_is_put_back():
    _, twin, stage = make()
    stage.connect()
    found = twin._axes["x"].speed
    stage.move_to({"x": 26.0}, speed_mm_s=1.0)
    assert twin._axes["x"].speed == round(772981.3692)
    stage.close()
    assert twin._axes["x"].speed == found


def turned_back(clock, twin, to_mm):
    """Return how far beyond a target below the carriage goes, mm, as another program's move would."""
    axis = twin._axes["x"]
    twin._move(0x50, axis, round(to_mm * axis.built.counts_per_mm))
    lowest = axis.motion.position_at(clock.now_s())
    while axis.motion.moving_at(clock.now_s()):
        clock.sleep_s(2e-3)
        lowest = min(lowest, axis.motion.position_at(clock.now_s()))
    assert axis.motion.position_at(clock.now_s()) == pytest.approx(to_mm, abs=1e-3)
    return to_mm - lowest


def test_moves_in_reverse_end_on_their_target_instead_of_passing_it():
    clock, twin, stage = make()
    assert turned_back(clock, twin, 24.0) == pytest.approx(0.05, abs=1e-3)
    stage.connect()
    assert twin._axes["x"].overshoot == 1728  # connecting changes nothing
    begin_s = clock.now_s()
    stage.begin_move({"x": 23.0}, speed_mm_s=1.0)
    lowest = 24.0
    while stage.status().moving:
        lowest = min(lowest, twin.positions_mm_at(clock.now_s())["x"])
        clock.sleep_s(5e-3)
    assert lowest == pytest.approx(23.0, abs=1e-3)
    assert clock.now_s() - begin_s == pytest.approx(1.0 + 1.0 / 4.5, abs=0.05)
    assert any("passed their target by 0.05 mm" in one for one in stage.incidents)
    stage.close()
    assert turned_back(clock, twin, 22.0) == pytest.approx(0.05, abs=1e-3)


def test_a_sweep_in_reverse_may_end_where_the_travel_does():
    """With the distance at power-up the carriage would run into the end of the travel before it comes back."""
    clock, twin, stage = make({"x": BUILT["Z812"]})
    stage.connect()
    stage.move_to({"x": 0.01})
    assert stage.positions_mm()["x"] == pytest.approx(0.01, abs=1e-4)
    assert min(twin.positions_mm_at(when_s)["x"] for when_s in (clock.now_s() - 0.01 * k for k in range(200))) > 0


def test_settings_that_a_power_cut_has_undone_are_made_again_behind_the_homing():
    _, twin, stage = make()
    stage.connect()
    stage.move_to({"x": 24.0}, speed_mm_s=1.0)
    twin.power_cycle()
    stage.home()
    stage.move_to({"x": 2.0}, speed_mm_s=1.0)
    assert twin._axes["x"].overshoot == 0
    assert twin._axes["x"].speed == round(772981.3692)
    stage.move_to({"x": 1.0}, speed_mm_s=1.0)


def test_a_direct_drive_has_nothing_to_switch_off():
    _, twin, stage = make({"x": BUILT["MLS203-X"]}, KinesisOptions(stages={"x": "MLS203-X"}))
    stage.connect()
    stage.move_to({"x": 50.0})
    stage.move_to({"x": 45.0})
    assert not stage.incidents
    stage.close()
    assert twin._axes["x"].overshoot == 0


def test_the_speed_of_a_killed_session_is_no_limit():
    clock, twin, stage = make()
    stage.connect()
    stage.move_to({"x": 26.0}, speed_mm_s=0.2)
    stage._link.close()  # killed: nothing was put back
    again = KinesisStage("stage0", twin.open(), clock)
    assert again.connect().axes["x"].max_speed_mm_s == 2.4
    begin_s = clock.now_s()
    again.move_to({"x": 31.0})
    assert clock.now_s() - begin_s < 5.0


def test_a_motor_that_is_off_is_switched_on_for_a_move_and_that_is_told():
    _, _, stage = make(enabled=False)
    stage.connect()
    assert stage.move_to({"x": 26.0})["x"] == pytest.approx(26.0, abs=1e-4)
    assert any("was off and has been switched on" in one for one in stage.incidents)


def test_a_stop_brakes():
    clock, twin, stage = make()
    stage.connect()
    stage.begin_move({"x": 45.0})
    clock.sleep_s(1.0)
    before = twin.positions_mm_at(clock.now_s())["x"]
    stage.stop()
    assert twin.positions_mm_at(clock.now_s())["x"] - before == pytest.approx(2.4**2 / 2 / 4.5, abs=0.1)


def test_a_stop_before_the_status_shows_the_motion_waits_for_rest():
    clock, twin, stage = make()
    stage.connect()
    stage.begin_move({"x": 45.0})
    stage.stop()
    rest = twin.positions_mm_at(clock.now_s())["x"]
    clock.sleep_s(2.0)
    assert twin.positions_mm_at(clock.now_s())["x"] == rest


def test_a_controller_at_its_limit_switch_warns():
    _, _, stage = make({"x": AptAxis(start_mm=110.0)}, KinesisOptions(stages={"x": "MLS203-X"}))
    stage.connect()
    assert stage.status().warnings == ("axis x: at a limit switch",)


@pytest.mark.parametrize(
    "fault",
    [
        "serial.reply_lost",
        "serial.reply_in_pieces",
        "serial.noise",
        "serial.reply_cut",
        "serial.request_lost",
        "serial.reply_twice",
        "kinesis.complains",
    ],
)
def test_faults_of_the_line_are_survived(fault):
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject(fault, about="0x0412" if fault != "serial.request_lost" else "0x0411")
    assert stage.positions_mm()["x"] == pytest.approx(25.0, abs=1e-4)
    assert twin.faults.struck
    if fault == "kinesis.complains":
        assert "error 7: a text that says what is wrong" in stage.incidents[0]


def test_noise_without_an_end_is_told_as_such():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("serial.babble", about="0x0412", times=2)
    with pytest.raises(BadReplyError, match="bytes that are no message"):
        stage.positions_mm()


def test_an_answer_that_is_too_short_is_refused():
    clock = VirtualClock()
    info = bytes.fromhex("06 00 04 00 81 50 00 00 00 00")
    stage = KinesisStage("stage0", ScriptedPort(clock, [info, info]), clock)
    with pytest.raises(BadReplyError, match="too few bytes"):
        stage.connect()


def test_errors_without_a_text_are_noted():
    clock = VirtualClock()
    stage = KinesisStage("stage0", ScriptedPort(clock, [bytes.fromhex("80 00 00 00 01 50")]), clock)
    with pytest.raises(NoAnswerError):
        stage.connect()
    assert any("an error without a text" in one for one in stage.incidents)


def test_a_stage_without_acceleration_is_refused():
    _, twin, stage = make()
    twin._axes["x"].acceleration = 0
    with pytest.raises(BadReplyError, match="no acceleration"):
        stage.connect()


def test_a_bay_that_the_controller_does_not_have_is_refused():
    settings = KinesisOptions(axes={"x": 3}, stages={"x": "MLS203-X"})
    _, _, stage = make({"x": AptAxis(), "y": AptAxis()}, settings, model="BBD202")
    with pytest.raises(UnsupportedError, match="2 bays, an axis is in bay 3"):
        stage.connect()


@pytest.mark.parametrize(
    ("stated", "built", "told"),
    [
        ("MLS203-X", "DDSM100", "DDSM100, 2000 counts per mm, 100 mm of travel"),
        ("MLS203-X", "MLS203-Y", "MLS203, 20000 counts per mm, 75 mm of travel"),
    ],
)
def test_another_stage_than_the_rig_files_is_refused_where_its_plug_tells(stated, built, told):
    _, _, stage = make({"x": BUILT[built]}, KinesisOptions(stages={"x": stated}))
    with pytest.raises(UnsupportedError, match=f"axis x: {told}.*20000 counts per mm and 110 mm"):
        stage.connect()
    settings = KinesisOptions(stages={"x": stated}, counts_per_mm={"x": BUILT[built].counts_per_mm})
    _, _, stage = make({"x": BUILT[built]}, settings)
    stage.connect()


def test_a_brushless_controller_that_does_not_tell_the_stage_is_taken_at_the_rig_files_word():
    _, twin, stage = make({"x": BUILT["MLS203-X"]}, KinesisOptions(stages={"x": "MLS203-X"}))
    twin.faults.inject("serial.request_lost", about="0x04f1")
    stage.connect()
    assert twin.faults.struck
    assert stage.positions_mm()["x"] == pytest.approx(55.0, abs=1e-4)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"axes": {"x": 1, "y": 2}}, "must name the same axes"),
        ({"stages": {"x": "MTS5O"}}, "'MTS5O'; allowed: MTS25-Z8"),
        ({"counts_per_mm": {"y": 1.0}}, "some of them"),
        ({"axes": {"x": 1, "y": 1}, "stages": {"x": "MLS203-X", "y": "MLS203-Y"}}, "different bays"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(table, said):
    with pytest.raises(ValidationError, match=said):
        KinesisOptions(**table)


def test_closing_a_dead_line_lets_go_of_it():
    _, twin, stage = make()
    stage.connect()
    stage.move_to({"x": 26.0}, speed_mm_s=1.0)
    twin.unplug()
    stage.close()
    stage.close()
