"""What GRBL controllers do where one would guess otherwise: each case of `manners/grbl.toml` and its neighbours."""

from dataclasses import replace

import pytest

from gs2ci.core.mechanics import Mechanics
from gs2ci_drivers.failures import (
    BadReplyError,
    DeviceFaultError,
    MoveFailedError,
    OutOfRangeError,
    ReferenceLostError,
    RefusedError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_sims.wires.grbl_build import GrblMachine, stepped_rate_hz
from gs2ci_sims.world import VirtualClock
from tests.drivers.grbl_builds import FLUIDNC, GRBLHAL
from tests.twins.grbl import GRBL, GrblBuild, GrblTwin, OddMachine

GREETINGS = [
    b"GrblHAL 1.1f ['$' or '$HELP' for help]",
    b"Grbl 3.9 [FluidNC v3.9.1 (esp32-wifi) '$' for help]",
    b"Grbl 1.2h ['$' for help]",
    b"Grbl 1.3a ['$' for help]",
    b"Welcome to the stage of room 12",
    b"***",
]


def make(machine=None, axes=("x",), **options):
    clock = VirtualClock()
    twin = GrblTwin(clock, machine, **options)
    return clock, twin, opened(twin, clock, axes)


def opened(twin, clock, axes=("x",)):
    return GrblStage("stage0", twin.open(), clock, GrblOptions(axes=axes))


def true_mm(twin, clock, axis="x"):
    return twin.positions_mm_at(clock.now_s())[axis]


def rests(twin, clock, seconds=3.0):
    before = twin.positions_mm_at(clock.now_s())
    clock.sleep_s(seconds)
    return twin.positions_mm_at(clock.now_s()) == before


# G1, G14: the step timer


@pytest.mark.parametrize(("steps", "speed", "real"), [(80, 0.3, 0.38147), (80, 0.02, 0.38147), (320, 0.05, 0.095367)])
def test_the_twin_steps_no_slower_than_an_avrs_timer(steps, speed, real):
    clock, twin, _ = make(GrblMachine(settings={100: steps}))
    twin.run_program(f"$J=G53X-90F{speed * 60}")
    clock.sleep_s(1.0)
    before = true_mm(twin, clock)
    clock.sleep_s(1.0)
    assert true_mm(twin, clock) - before == pytest.approx(real, rel=1e-4)


@pytest.mark.parametrize("speed_mm_s", [1.0, 12.5, 20.0, 30.0])
def test_the_twin_is_as_slow_as_the_timers_rounding_makes_it(speed_mm_s):
    asked_hz = speed_mm_s * 320
    assert 1e-4 < 1 - stepped_rate_hz(asked_hz) / asked_hz < 1.1e-3


@pytest.mark.parametrize("speed_mm_s", [0.3, 0.1, 0.02])
def test_a_speed_that_it_cannot_step_is_refused_with_the_lowest_one(speed_mm_s):
    clock, twin, stage = make(GrblMachine(settings={100: 80}))
    stage.connect()
    assert stage.info.axes["x"].min_speed_mm_s == pytest.approx(0.38147, rel=1e-4)
    for call in (
        lambda: stage.begin_move({"x": -99.0}, speed_mm_s=speed_mm_s),
        lambda: stage.plan_sweep("x", -100.0, -99.0, speed_mm_s),
    ):
        with pytest.raises(OutOfRangeError, match=r"slower than it can step.*allowed: 0.3815 to 30 mm/s"):
            call()
    assert rests(twin, clock)


@pytest.mark.parametrize("speed_mm_s", [0.1, 0.5, 3.3, 12.5, 25.0, 30.0])
def test_the_speed_that_a_sweep_states_is_the_one_that_is_stepped(speed_mm_s):
    clock, twin, stage = make(GrblMachine(settings={120: 2000}))
    stage.connect()
    sweep = stage.plan_sweep("x", -100.0, -98.0, speed_mm_s)
    stage.prepare_sweep(sweep)
    stage.begin_sweep(sweep)
    begin_s = clock.now_s() + sweep.lead_s + 0.02
    stage.wait_idle(60.0)
    x = [twin.positions_mm_at(begin_s + t)["x"] for t in (0.0, 0.01)]
    assert abs(x[1] - x[0]) / 0.01 == pytest.approx(sweep.speed_mm_s, rel=2e-6)
    assert sweep.speed_mm_s == pytest.approx(speed_mm_s, rel=1e-3)


def test_other_processors_have_no_lowest_rate():
    _, _, stage = make(OddMachine(build=GRBLHAL, settings={100: 80}))
    stage.connect()
    assert stage.info.axes["x"].min_speed_mm_s == pytest.approx(1 / 60)
    assert stage.info.model == "grblHAL controller"


# G2, G4, G9: stop means at rest and nothing pending


@pytest.mark.parametrize("after_s", [0.0, 5e-4, 1e-3, 1.9e-3, 2e-3, 3e-3, 4e-3, 6e-3, 0.1])
@pytest.mark.parametrize("new_session", [False, True])
def test_a_stop_that_comes_before_the_jog_has_begun_stops_it(after_s, new_session):
    clock, twin, stage = make()
    stage.connect()
    stage._link.send(b"$J=G53 G21 G90 X-88.0000 F600.000\n", "jog")  # and nobody waits for its answer
    clock.sleep_s(after_s)
    if new_session:
        stage.close()
        stage = opened(twin, clock)
        stage.connect()
    stage.stop()
    assert rests(twin, clock)
    assert stage.status().referenced
    assert not stage.status().moving


def test_the_twin_drops_a_cancel_that_comes_before_the_jog_and_says_idle():
    clock, _, stage = make()
    stage.connect()
    stage._link.send(b"$J=G53 G21 G90 X-88.0000 F600.000\n\x85?", "jog")
    assert stage._link._next(clock.now_s() + 1.0, "?").startswith("<Idle|")
    clock.sleep_s(0.5)
    assert stage.status().moving


def test_a_move_that_was_asked_for_on_hold_is_refused_and_does_not_come_later():
    clock, twin, stage = make()
    stage.connect()
    twin.press("hold")
    with pytest.raises(WrongStateError, match=r"state Hold.*release the hold"):
        stage.move_to({"x": -97.0})
    twin.press("resume")
    assert rests(twin, clock)
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)


def test_a_move_that_a_hold_has_swallowed_is_taken_back_and_the_hold_is_named():
    clock, twin, stage = make()
    stage.connect()
    twin.faults.inject("grbl.held")
    with pytest.raises(MoveFailedError, match="state Hold: the move was neither read nor answered, and is taken back"):
        stage.move_to({"x": -97.0})
    stage.close()
    twin.press("resume")
    assert rests(twin, clock)
    again = opened(twin, clock)
    again.connect()
    assert again.status().referenced
    assert again.positions_mm()["x"] == pytest.approx(-100.0)


def test_an_open_door_takes_no_move_and_nothing_comes_when_it_is_closed():
    clock, twin, stage = make(OddMachine(build=GrblBuild(options="V+")))
    stage.connect()
    twin.open_door()
    assert stage.status().faults == ("state Door",)
    with pytest.raises(WrongStateError, match="state Door"):
        stage.move_to({"x": -97.0})
    stage.stop()
    twin.release()
    assert rests(twin, clock)
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)


def test_a_program_of_others_is_held_and_then_dropped():
    clock, twin, stage = make()
    stage.connect()
    twin.run_program("G1X-20F1200")
    clock.sleep_s(0.3)
    begin_s = clock.now_s()
    stage.stop()
    assert clock.now_s() - begin_s < 1.0
    assert rests(twin, clock)
    twin.press("resume")
    assert rests(twin, clock)
    assert stage.status().referenced  # it was held before it was reset
    assert stage.positions_mm()["x"] == pytest.approx(true_mm(twin, clock), abs=0.002)


# G3, G10: reconnecting


@pytest.mark.parametrize("line", ["$J=G53X-20F1200", "G1X-20F1200"])
def test_a_session_that_finds_it_in_mid_move_stops_it_and_then_asks(line):
    clock, twin, _ = make()
    twin._session = None
    twin.run_program(line)
    clock.sleep_s(0.3)
    stage = opened(twin, clock)
    assert stage.connect().firmware == "1.1h.20190825"
    assert "it moved when it was connected, and was stopped" in stage.incidents[-1]
    assert rests(twin, clock)
    assert stage.status().referenced
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)


def test_the_twin_refuses_its_build_and_its_settings_in_mid_move():
    clock, twin, stage = make()
    stage.connect()
    twin.run_program("G1X-20F1200")
    clock.sleep_s(0.3)
    for line in ("$I", "$$", "$N", "$H"):
        with pytest.raises(RefusedError, match="error:8"):
            stage._link.command(line)


@pytest.mark.parametrize("rest", [b"$J=G53 G21 G90 X-9", b"G1X1F100", b"$100=8", b"(half a comm"])
def test_half_a_line_of_a_killed_program_is_not_executed_and_disturbs_nothing(rest):
    clock, twin, stage = make()
    stage._link.send(rest, "killed")
    twin._session = None
    again = opened(twin, clock)
    again.connect()
    assert rests(twin, clock)
    assert again.info.axes["x"].step_mm == pytest.approx(1 / 320)


@pytest.mark.parametrize("state", ["Hold", "Door", "Sleep", "Check"])
def test_a_controller_that_takes_no_commands_is_refused_with_its_state(state):
    clock, twin, stage = make(OddMachine(build=GrblBuild(options="V+")))
    {
        "Hold": lambda: twin.press("hold"),
        "Door": twin.open_door,
        "Sleep": lambda: twin.run_program("$SLP"),
        "Check": lambda: twin.run_program("$C"),
    }[state]()
    clock.sleep_s(0.1)
    with pytest.raises(DeviceFaultError, match=f"state {state}.*press reset at the controller"):
        stage.connect()
    twin._ajar = False
    twin.press("reset")
    clock.sleep_s(0.1)
    stage.connect()


# G5: where homing sets zero


@pytest.mark.parametrize(
    ("options", "mask", "low_mm", "high_mm", "home_mm"),
    [("V", 0, -200, 0, -1), ("V", 1, -200, 0, -199), ("VZ", 0, -200, 0, 0), ("VZ", 1, 0, 200, 0)],
)
@pytest.mark.parametrize("soft_limits", [0, 1])
def test_the_travel_is_the_one_of_the_build(options, mask, low_mm, high_mm, home_mm, soft_limits):
    build = GrblBuild(options=options)
    start_mm = (100.0 if high_mm else -100.0, -100.0, -10.0)
    clock, twin, stage = make(OddMachine({20: soft_limits, 23: mask}, start_mm, build=build, homed=False))
    axis = stage.connect().axes["x"]
    assert (axis.min_mm, axis.max_mm) == (low_mm, high_mm)
    assert stage.home()["x"] == pytest.approx(home_mm)
    for target_mm in (low_mm, high_mm):
        assert stage.move_to({"x": target_mm}, timeout_s=60.0)["x"] == pytest.approx(target_mm)
        assert true_mm(twin, clock) == pytest.approx(target_mm, abs=1e-6)
    with pytest.raises(OutOfRangeError):
        stage.move_to({"x": -30.0 if high_mm else 30.0})


def test_a_fluidnc_stage_has_the_travel_of_its_homing_position():
    build = GrblBuild(
        FLUIDNC.greeting, FLUIDNC.version, "PHS", avr=False, unlisted=FLUIDNC.unlisted, homing_mm={0: 150.0, 1: 0, 2: 0}
    )
    _, _, stage = make(OddMachine(start_mm=(40.0, -100.0, -10.0), build=build, homed=False))
    axis = stage.connect().axes["x"]
    assert (axis.min_mm, axis.max_mm) == (-50.0, 150.0)
    assert stage.home()["x"] == pytest.approx(150.0)


# G6: restarts


@pytest.mark.parametrize("greeting", GREETINGS)
@pytest.mark.parametrize("moment", ["at rest", "moving", "unheard"])
@pytest.mark.parametrize("homing", [0, 1])
def test_a_restart_is_noticed_whatever_the_greeting_says(greeting, moment, homing):
    clock, twin, stage = make(OddMachine({22: homing}, build=GrblBuild(greeting)))
    stage.connect()
    stage.move_to({"x": -98.0})
    if moment == "unheard":
        twin.faults.inject("serial.reply_lost", about="banner")
    if moment == "moving":
        stage.begin_move({"x": -20.0})
        clock.after(0.7, twin.reboot)
        with pytest.raises(ReferenceLostError, match="restarted"):
            stage.wait_idle(60.0)
    else:
        twin.reboot()
        clock.sleep_s(2.0)
    assert not stage.status().referenced
    with pytest.raises(ReferenceLostError):
        stage.move_to({"x": -98.0})
    if moment != "moving":
        assert true_mm(twin, clock) == pytest.approx(-98.0)  # the carriage stands still, whatever the counter says
    if homing:
        stage.home()
        assert stage.move_to({"x": -98.0})["x"] == pytest.approx(true_mm(twin, clock), abs=1e-6)


@pytest.mark.parametrize("greeting", GREETINGS)
def test_a_hard_limit_can_be_homed_away_whatever_the_greeting_says(greeting):
    clock, twin, stage = make(OddMachine(build=GrblBuild(greeting)))
    stage.connect()
    twin._alarm(1)
    clock.sleep_s(1.0)
    stage.home()
    assert stage.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)


def test_somebody_who_moves_it_by_other_means_is_told_of_and_the_count_goes_on():
    clock, twin, stage = make()
    stage.connect()
    twin.run_program("$J=G53X-90F1200")
    clock.sleep_s(3.0)
    assert stage.status().referenced
    assert "changed from -100.000" in stage.incidents[-1]
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)


def test_a_build_that_does_not_lock_itself_is_homed_in_each_session():
    _, _, stage = make(OddMachine(build=GrblBuild(options="VL")))
    stage.connect()
    assert not stage.status().referenced
    assert "does not lock after power-on" in " ".join(stage.status().warnings)
    stage.home()
    assert stage.status().referenced


# G7: reset waits by $1


@pytest.mark.parametrize("lock_ms", [0, 25, 255])
def test_a_reset_in_motion_is_waited_for_by_its_setting(lock_ms):
    clock, twin, stage = make(GrblMachine({1: lock_ms}))
    stage.connect()
    stage.begin_move({"x": -20.0})
    clock.sleep_s(0.5)
    twin.faults.inject("grbl.silent_status", times=2)
    begin_s = clock.now_s()
    stage.stop()
    assert lock_ms / 1000 + 0.5 < clock.now_s() - begin_s < lock_ms / 1000 + 2.0
    assert rests(twin, clock)
    assert not stage.status().referenced
    stage.home()
    assert stage.status().referenced


# G8: $10=0


def test_work_positions_are_read_with_the_offset_of_the_first_report():
    machine = OddMachine({10: 0}, offset_mm=(-50.0, 0.0, 0.0))
    _, twin, stage = make(machine)
    for _ in range(3):
        twin._report()  # another program has heard the first ones
    stage.connect()
    for _ in range(25):
        assert stage.positions_mm()["x"] == pytest.approx(-100.0)
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)


# G11, G12, G13, G15: settings of others


def test_a_move_that_another_axis_forbids_names_that_axis():
    _, _, stage = make(GrblMachine(start_mm=(-100.0, -100.0, 5.0)))
    stage.connect()
    with pytest.raises(RefusedError, match=r"error:15.*axis z stands at 5.000 mm, outside -60 to 0 mm.*home the stage"):
        stage.move_to({"x": -97.0})
    assert stage.status().referenced


def test_motors_that_are_switched_off_between_moves_are_warned_of():
    assert "set $1=255" in " ".join(warnings({1: 25}))
    assert "set $1=255" not in " ".join(warnings({}))


@pytest.mark.parametrize("idle_ms", [255, 250])
def test_motors_that_fluidnc_switches_off_between_moves_are_warned_of(idle_ms):
    _, _, stage = make(OddMachine(build=replace(FLUIDNC, idle_ms=idle_ms)))
    stage.connect()
    told = "the motors are switched off 250 ms after every move: set idle_ms of stepping=255" in stage.status().warnings
    assert told == (idle_ms == 250)


def warnings(settings, axes=("x",), **build):
    _, _, stage = make(OddMachine(settings, build=GrblBuild(**build)), axes)
    stage.connect()
    return stage.status().warnings


def test_a_stage_of_one_axis_is_told_that_homing_drives_the_others():
    assert "homing drives y, z too, z first" in " ".join(warnings({}))
    assert "homing drives" not in " ".join(warnings({}, ("x", "y", "z")))
    assert "homing drives" not in " ".join(warnings({}, options="VH"))


def test_a_homing_that_a_missing_switch_of_z_ends_says_what_the_build_needs():
    clock, twin, stage = make(OddMachine(homed=False, switches="x"))
    stage.connect()
    with pytest.raises(MoveFailedError, match=r"ALARM:9.*HOMING_CYCLE_0 for its own axes only"):
        stage.home()
    assert true_mm(twin, clock, "z") == pytest.approx(-10.0 + 1.5 * 60.0)


def test_a_build_with_single_axis_homing_homes_only_the_axis_in_use():
    clock, twin, stage = make(OddMachine(homed=False, switches="x", build=GrblBuild(options="VH")))
    stage.connect()
    stage.home()
    assert true_mm(twin, clock) == pytest.approx(-1.0)
    assert true_mm(twin, clock, "z") == -10.0


@pytest.mark.parametrize("startup", [("G1X-98F600", ""), ("G21", "G28")])
def test_a_startup_line_that_moves_the_stage_is_refused(startup):
    clock, twin, stage = make(OddMachine({22: 0}, startup=startup))
    with pytest.raises(UnsupportedError, match=r"startup line moves the stage.*clear it with \$N0="):
        stage.connect()
    assert rests(twin, clock)


def test_a_startup_line_that_moves_nothing_is_none_of_our_business():
    _, _, stage = make(OddMachine(startup=("G21", "")))
    stage.connect()


def test_the_twin_runs_its_startup_lines_on_each_reset_at_rest():
    clock, twin, _ = make(OddMachine({22: 0}, startup=("G1X-98F600", "")))
    twin.press("reset")
    clock.sleep_s(3.0)
    assert true_mm(twin, clock) == pytest.approx(-98.0)


# G16: what others report


def test_a_fluidnc_controller_with_one_axis_is_a_stage():
    build = GrblBuild(
        FLUIDNC.greeting, FLUIDNC.version, "PHS", 1, avr=False, unlisted=FLUIDNC.unlisted, homing_mm={0: 0.0}
    )
    clock, twin, stage = make(OddMachine(build=build, homed=False))
    info = stage.connect()
    assert info.model == "FluidNC controller"
    stage.home()
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)
    with pytest.raises(BadReplyError, match=r"setting \$100 is missing|not positive"):
        opened_again(stage, twin, clock, ("y",)).connect()


WORDS = {
    3: "Invalid $ statement",
    8: "Command requires idle state",
    9: "GCode cannot be executed in lock or alarm state",
    15: "Max travel exceeded during jog",
}


def test_a_fluidnc_controller_that_words_its_errors_is_understood():
    build = replace(FLUIDNC, words=WORDS)
    _, twin, stage = make(OddMachine(build=build))
    stage.connect()
    twin._settings[130] = 50.0  # since it was connected: beyond the travel that the session knows
    with pytest.raises(RefusedError) as caught:
        stage.move_to({"x": -97.0})
    assert caught.value.code == "error:15"
    assert stage.status().referenced  # none of these words is taken for the greeting of a restart


def test_an_error_in_words_that_are_not_known_is_told_as_it_came():
    _, twin, stage = make(OddMachine(build=replace(FLUIDNC, words={20: "Unsupported GCode command"})))
    stage.connect()
    twin.faults.inject("grbl.error", about="$J")
    with pytest.raises(RefusedError, match="error:Unsupported GCode command"):
        stage.move_to({"x": -97.0})


def opened_again(stage, twin, clock, axes):
    stage.close()
    return opened(twin, clock, axes)


def test_a_controller_that_waits_for_a_tool_says_so_and_moves_nothing():
    _, twin, stage = make(OddMachine(build=GRBLHAL))
    stage.connect()
    twin._state = "Tool"
    assert stage.status().faults == ("state Tool",)
    with pytest.raises(WrongStateError, match="state Tool"):
        stage.move_to({"x": -97.0})


def test_an_emergency_stop_of_grblhal_is_named_and_homed_away_once_it_is_released():
    clock, twin, stage = make(OddMachine(build=GRBLHAL))
    stage.connect()
    stage.begin_move({"x": -90.0})
    clock.sleep_s(0.5)
    twin.press_stop()
    clock.sleep_s(0.1)
    with pytest.raises(MoveFailedError, match=r"ALARM:10 .*grblHAL: emergency stop"):
        stage.wait_idle(10.0)
    stage = opened_again(stage, twin, clock, ("x",))
    stage.connect()
    with pytest.raises(RefusedError, match=r"emergency stop.*release the stop") as caught:
        stage.home()
    assert caught.value.code == "error:79"
    twin.release_stop()
    stage.home()
    assert stage.move_to({"x": -97.0})["x"] == pytest.approx(-97.0)
    assert true_mm(twin, clock) == pytest.approx(-97.0)


@pytest.mark.parametrize("build", [GRBLHAL, FLUIDNC])
def test_a_start_without_homing_is_told_in_the_words_of_its_alarm(build):
    _, twin, stage = make(OddMachine(build=build))
    stage.connect()
    stage.close()
    twin.reboot()
    stage = opened(twin, stage.clock)
    stage.connect()
    assert stage.status().faults[0].startswith(f"ALARM:{build.unhomed} (grblHAL: ")
    assert not stage.status().referenced
    stage.home()
    assert stage.status().faults == ()
    assert stage.status().referenced


def test_a_fluidnc_axis_that_may_not_be_homed_alone_is_homed_with_the_others():
    clock, twin, stage = make(OddMachine(homed=False, build=replace(FLUIDNC, alone=False)))
    stage.connect()
    stage.home()
    assert true_mm(twin, clock) == pytest.approx(0.0, abs=1e-9)
    assert true_mm(twin, clock, "z") == pytest.approx(0.0, abs=1e-9)


# The twin where the driver was right before


def test_the_twin_refuses_a_jog_in_alarm_as_not_idle():
    _, _, stage = make(GrblMachine(homed=False))
    stage.connect()
    with pytest.raises(RefusedError, match="error:8"):
        stage._link.command("$J=G53X-90F600")


def test_the_twin_ends_a_jog_in_idle_when_hold_is_pressed():
    clock, twin, stage = make()
    stage.connect()
    stage.begin_move({"x": -20.0})
    clock.sleep_s(0.5)
    twin.press("hold")
    with pytest.raises(MoveFailedError, match="short of its target"):
        stage.wait_idle(60.0)
    assert stage.status().faults == ()


def test_the_twins_door_counts_as_open_and_then_as_closed():
    clock, twin, stage = make(OddMachine(build=GrblBuild(options="V+")))
    stage.connect()
    stage.begin_move({"x": -20.0})
    clock.sleep_s(0.5)
    twin.open_door()
    clock.sleep_s(1.0)
    assert stage._link.status().substate == 1
    twin._ajar = False
    assert stage._link.status().substate == 0
    twin.release()
    assert stage._link.status().state == "Idle"


def test_the_twin_dwells_in_whole_steps_and_in_idle():
    clock, _, stage = make()
    stage.connect()
    begin_s = clock.now_s()
    stage._link._lines.send(b"G4P0.01\n", "dwell")
    assert stage._link.status().state == "Idle"
    stage._link._next(clock.now_s() + 1.0, "dwell")
    assert clock.now_s() - begin_s == pytest.approx(0.05, abs=0.01)


def test_the_twin_homes_z_first_then_x_and_y_fast_and_then_slowly():
    clock, twin, stage = make(GrblMachine(homed=False))
    stage.connect()
    stage._link.send(b"$H\n", "$H")
    clock.sleep_s(0.5)
    assert (true_mm(twin, clock), true_mm(twin, clock, "z")) == (-100.0, pytest.approx(-10.0 + 8.333 * 0.5, abs=0.5))
    clock.sleep_s(40.0)
    assert [round(twin.positions_mm_at(clock.now_s())[axis], 3) for axis in "xyz"] == [-1.0, -1.0, -1.0]
    assert GRBL.options == "V"


def test_steps_that_the_motor_loses_change_no_report():
    clock, twin, stage = make(GrblMachine(mechanics={"x": Mechanics(slip_mm=0.5, seed=1)}))
    stage.connect()
    assert stage.move_to({"x": -90.0})["x"] == pytest.approx(-90.0)
    assert true_mm(twin, clock) < -90.05
    stage.home()
    assert stage.positions_mm()["x"] == pytest.approx(true_mm(twin, clock), abs=0.5)
