import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gs2ci_drivers.failures import (
    BadReplyError,
    DriverError,
    MoveFailedError,
    NoAnswerError,
    RefusedError,
    UnsupportedError,
)
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.wires.zaber import ZaberAxis, ZaberTwin
from gs2ci_sims.world import VirtualClock
from tests.drivers.scripted import ScriptedPort
from tests.twins import zaber as odd
from tests.twins.zaber import OddAxis

STEP = 0.000047625


OLD = "6.28"


def make(firmware="7.28", axis=None, **options):
    clock = VirtualClock()
    twin = odd.ZaberTwin(clock, axis or OddAxis(), firmware=firmware)
    stage = ZaberStage("stage0", twin.open(), clock, ZaberOptions(axes={"x": 1}, microstep_mm={"x": STEP}, **options))
    return clock, twin, stage


def test_a_slow_move_changes_no_setting_so_that_a_kill_on_the_way_leaves_the_stage_as_it_was():
    clock, twin, stage = make()
    own = stage.connect().axes["x"].max_speed_mm_s
    stage.begin_move({"x": 80.0}, speed_mm_s=5.0)
    clock.sleep_s(0.3)
    before_mm = twin.positions_mm_at(clock.now_s())["x"]
    clock.sleep_s(0.1)
    assert twin.positions_mm_at(clock.now_s())["x"] - before_mm == pytest.approx(0.5, abs=1e-3)
    assert twin._axes[0].speed_mm_s() == pytest.approx(own)  # killed here, nothing is left behind
    twin._session = None
    twin.power_cycle()
    again = ZaberStage("stage0", twin.open(), clock, ZaberOptions())
    assert again.connect().axes["x"].max_speed_mm_s == pytest.approx(own)


def test_old_firmware_keeps_its_own_speed_unless_the_rig_file_says_what_to_put_back():
    _, twin, stage = make(OLD)
    own = stage.connect().axes["x"].max_speed_mm_s
    stage.move_to({"x": 80.0})
    with pytest.raises(UnsupportedError, match=rf"own_speed_mm_s = \{{ x = {own:.4g} \}}"):
        stage.move_to({"x": 75.0}, speed_mm_s=5.0)
    assert twin._axes[0].speed_mm_s() == pytest.approx(own)


def test_what_a_killed_session_left_in_old_firmware_is_put_back_on_connecting():
    clock, twin, stage = make(OLD, own_speed_mm_s={"x": 40.0})
    own = stage.connect().axes["x"].max_speed_mm_s
    assert own == pytest.approx(40.0, abs=1e-4)
    stage.begin_move({"x": 80.0}, speed_mm_s=5.0)
    twin._session = None  # killed
    twin.power_cycle()
    twin._axes[0].flags.clear()  # it has an absolute encoder
    assert twin._axes[0].speed_mm_s() == pytest.approx(5.0, abs=1e-4)
    again = ZaberStage("stage0", twin.open(), clock, ZaberOptions(own_speed_mm_s={"x": 40.0}))
    assert again.connect().axes["x"].max_speed_mm_s == pytest.approx(own)
    assert [text for text in again.incidents if "maxspeed of axis x was 5 mm/s" in text]
    again.move_to({"x": 60.0}, speed_mm_s=30.0)
    assert twin._axes[0].speed_mm_s() == pytest.approx(own)


def test_old_firmware_has_its_own_speed_back_after_a_slow_move_and_after_closing_in_mid_move():
    _, twin, stage = make(OLD, own_speed_mm_s={"x": 40.0})
    own = stage.connect().axes["x"].max_speed_mm_s
    stage.move_to({"x": 80.0}, speed_mm_s=5.0)
    assert twin._axes[0].speed_mm_s() == pytest.approx(own)
    stage.begin_move({"x": 75.0}, speed_mm_s=5.0)
    stage.close()
    assert twin._axes[0].speed_mm_s() == pytest.approx(own)


@pytest.mark.parametrize(("resolution", "microstep"), [(128, "2.38125e-05"), (32, "9.525e-05")])
def test_another_resolution_than_the_rig_file_speaks_of_is_refused_with_the_right_microstep(resolution, microstep):
    _, _, stage = make(axis=OddAxis(resolution=resolution))
    with pytest.raises(UnsupportedError, match=rf"resolution = {resolution} and microstep_mm = \{{ x = {microstep}"):
        stage.connect()


def test_a_direct_drive_has_no_resolution_to_be_checked():
    _, _, stage = make(axis=OddAxis(resolution=None))
    assert stage.connect().axes["x"].step_mm == pytest.approx(STEP)


def test_closing_a_dead_line_raises_nothing():
    _, twin, stage = make()
    stage.connect()
    stage.begin_move({"x": 80.0}, speed_mm_s=5.0)
    twin.unplug()
    stage.close()


def test_without_checksums_the_same_stage_works():
    _, _, stage = make(checksums=False)
    stage.connect()
    assert stage.move_to({"x": 76.0})["x"] == pytest.approx(76.0, abs=STEP)


def test_an_axis_that_the_device_lacks_is_refused():
    clock = VirtualClock()
    twin = ZaberTwin(clock, {"x": ZaberAxis()})
    stage = ZaberStage("stage0", twin.open(), clock, ZaberOptions(axes={"y": 2}, microstep_mm={"y": STEP}))
    with pytest.raises(UnsupportedError, match=r"axis 'y' is number 2.*allowed: 1 to 1"):
        stage.connect()


@pytest.mark.parametrize("maxspeed", ["0", "-153600"])
def test_an_axis_whose_own_speed_moves_nothing_is_a_bad_reply(maxspeed):
    _, twin, stage = make()
    original = twin._do_get
    twin._do_get = lambda number, words: maxspeed if words == ["maxspeed"] else original(number, words)
    with pytest.raises(BadReplyError, match="axis x cannot move"):
        stage.connect()


@pytest.mark.parametrize("flags", [{"WR"}, {"FZ", "WR"}, {"FS", "WL"}, {"FO"}, {"NI"}])
def test_an_axis_that_is_not_in_use_does_not_concern_the_stage(flags):
    clock = VirtualClock()
    twin = ZaberTwin(clock, {"x": ZaberAxis(), "empty": ZaberAxis()})
    twin._axes[1].flags |= flags
    stage = ZaberStage("stage0", twin.open(), clock, ZaberOptions(axes={"x": 1}, microstep_mm={"x": STEP}))
    stage.connect()
    status = stage.status()
    assert (status.referenced, status.faults, status.warnings) == (True, (), ())
    assert stage.move_to({"x": 76.0})["x"] == pytest.approx(76.0, abs=STEP)
    stage.begin_move({"x": 80.0})
    stage.stop()
    assert stage.move_to({"x": 75.0})["x"] == pytest.approx(75.0, abs=STEP)
    assert twin._axes[1].flags == flags


@pytest.mark.parametrize("flag", ["WR", "FS", "FO", "NI"])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_flags_of_every_axis_in_use_are_heard(flag, axis):
    clock = VirtualClock()
    twin = ZaberTwin(clock, {"x": ZaberAxis(), "y": ZaberAxis()})
    stage = ZaberStage(
        "stage0", twin.open(), clock, ZaberOptions(axes={"x": 1, "y": 2}, microstep_mm={"x": STEP, "y": STEP})
    )
    stage.connect()
    twin._axes[axis].flags.add(flag)
    twin._axes[1 - axis].flags.add("NC")
    status = stage.status()
    assert [text[:2] for text in (*status.faults, *status.warnings)].count(flag) == 1
    assert status.referenced == (flag != "WR")


def test_a_warning_list_that_is_none_is_a_bad_reply():
    clock = VirtualClock()
    _, twin, stage = make()
    stage.connect()
    twin._do_warnings = lambda number, words: "02 FS"
    with pytest.raises(BadReplyError, match="not a count and its flags"):
        stage.status()
    assert clock.now_s() > 0


def test_a_position_that_is_no_number_is_a_bad_reply():
    _, twin, stage = make()
    stage.connect()
    original = twin._do_get
    twin._do_get = lambda number, words: "many" if words == ["pos"] else original(number, words)
    with pytest.raises(BadReplyError, match="not a number"):
        stage.positions_mm()


def test_a_late_answer_to_an_earlier_question_is_not_taken_for_the_present_one():
    clock, twin, stage = make()
    stage.connect()
    before = stage.positions_mm()
    twin.faults.inject("serial.reply_late", value=0.55, about="get pos")
    assert stage.positions_mm() == before
    clock.sleep_s(1.0)
    stage.move_to({"x": 77.0})
    assert stage.positions_mm()["x"] == pytest.approx(77.0, abs=STEP)
    assert stage.incidents


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("zaber.stall", MoveFailedError, "FS"),
        ("zaber.slip", MoveFailedError, "short of its target"),
        ("zaber.never_idle", NoAnswerError, "arrival"),
        ("zaber.reject", RefusedError, "AGAIN"),
    ],
)
def test_a_failed_move_is_never_taken_for_an_arrival(fault, error, words):
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject(fault, about="move" if fault == "zaber.reject" else "")
    with pytest.raises(error, match=words):
        stage.move_to({"x": 100.0})


def test_homing_against_an_obstacle_fails_with_its_flag():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("zaber.stall", about="home")
    with pytest.raises(MoveFailedError, match=r"home.*FS"):
        stage.home()


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.binary(min_size=1, max_size=120), max_size=12))
def test_a_line_that_babbles_gives_typed_errors_and_never_hangs(answers):
    clock = VirtualClock()
    stage = ZaberStage(
        "stage0", ScriptedPort(clock, answers), clock, ZaberOptions(axes={"x": 1}, microstep_mm={"x": STEP})
    )
    begin_s = clock.now_s()
    with pytest.raises(DriverError):
        stage.connect()
    assert clock.now_s() - begin_s < 5.0


def test_a_port_that_was_closed_neither_takes_nor_gives():
    _, twin, stage = make()
    stage.close()
    port = twin.open()
    port.close()
    with pytest.raises(OSError, match="the port is closed"):
        port.write(b"/1\n", 1.0)
    with pytest.raises(OSError, match="the port is closed"):
        port.read(10, 1.0)


def test_where_nothing_answers_the_binary_protocol_is_named():
    """A T-Series device answers messages of six bytes, and no others (docs.rs/zproto, module binary)."""
    clock = VirtualClock()
    with pytest.raises(NoAnswerError, match=r"binary protocol \(9600 baud\).*firmware 5 \(T-Series\) has no other"):
        ZaberStage("stage0", ScriptedPort(clock, []), clock, ZaberOptions()).connect()
