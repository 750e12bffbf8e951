import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from gs2ci_drivers.failures import (
    BadReplyError,
    DriverError,
    MoveFailedError,
    NoAnswerError,
    ReferenceLostError,
    RefusedError,
    UnsupportedError,
)
from gs2ci_drivers.grbl.driver import GrblStage
from gs2ci_drivers.grbl.options import GrblOptions
from gs2ci_drivers.stage import StageStatus
from gs2ci_sims.wires.grbl_build import GrblMachine
from gs2ci_sims.world import VirtualClock
from tests.drivers.scripted import ScriptedPort
from tests.twins.grbl import GrblTwin


def make(machine=None, **options):
    clock = VirtualClock()
    twin = GrblTwin(clock, machine, **options)
    return clock, twin, GrblStage("stage0", twin.open(), clock, GrblOptions(axes=("x",)))


def test_a_controller_that_boots_on_opening_is_waited_for():
    clock, _, stage = make(GrblMachine(settings={22: 0}), board="uno")
    assert stage.connect().firmware.startswith("1.1h")
    assert clock.now_s() > 1001.0


def opened(twin, clock, **line):
    return GrblStage("stage0", twin.open(**line), clock, GrblOptions(axes=("x",)))


def test_an_uno_keeps_its_reference_from_session_to_session_where_the_line_stays_up():
    clock = VirtualClock()
    twin = GrblTwin(clock, GrblMachine(homed=False), board="uno")
    stage = opened(twin, clock)
    stage.connect()
    stage.home()
    stage.move_to({"x": -20.0})
    stage.close()
    clock.sleep_s(10.0)
    again = opened(twin, clock)
    again.connect()
    assert again.status().referenced
    assert again.positions_mm()["x"] == pytest.approx(-20.0, abs=0.01)


@pytest.mark.parametrize("line", [{"hangs_up": True}, {"lowers": True}])
def test_an_uno_loses_it_where_the_line_falls(line):
    clock = VirtualClock()
    twin = GrblTwin(clock, GrblMachine(homed=False), board="uno")
    stage = opened(twin, clock, **line)
    stage.connect()
    stage.home()
    stage.close()
    again = opened(twin, clock, **line)
    again.connect()
    assert not again.status().referenced


def test_a_board_with_usb_of_its_own_talks_while_dtr_is_high_and_not_else():
    clock = VirtualClock()
    assert opened(GrblTwin(clock, board="native"), clock).connect().firmware.startswith("1.1h")
    with pytest.raises(NoAnswerError):
        opened(GrblTwin(clock, board="native"), clock, lowers=True).connect()


class Marlin:
    """A board with Marlin, as a `BytePort`: lines are answered, single bytes are the begin of one.

    MarlinFirmware/Marlin: queue.cpp (get_serial_commands: until a line end), M115.cpp, MarlinCore.cpp ("start").
    """

    def __init__(self, clock, boots):
        self._clock, self._line, self.sent = clock, b"", []
        self._out = b"start\necho:Marlin 2.1.2.1\n" if boots else b""

    def write(self, data, timeout_s):
        *lines, self._line = (self._line + data).split(b"\n")
        for line in lines:
            self.sent.append(line)
            if line == b"M115":
                self._out += (
                    b"FIRMWARE_NAME:Marlin 2.1.2.1 (Jan  1 2024) SOURCE_CODE_URL:github.com/M PROTOCOL_VERSION:1.0\n"
                )
                self._out += b"Cap:EEPROM:1\nok\n"
            elif line.strip():
                self._out += b'echo:Unknown command: "' + line + b'"\nok\n'

    def read(self, max_bytes, timeout_s):
        if not self._out:
            self._clock.sleep_s(timeout_s)
        given, self._out = self._out[:max_bytes], self._out[max_bytes:]
        return given

    def close(self):
        pass


@pytest.mark.parametrize("boots", [True, False])
def test_a_printers_board_is_named(boots):
    clock = VirtualClock()
    board = Marlin(clock, boots)
    stage = GrblStage("stage0", board, clock)
    with pytest.raises(UnsupportedError, match=r"the board runs Marlin 2.1.2.1 \(Jan  1 2024\).*GRBL 1.1, grblHAL"):
        stage.connect()
    assert not [line for line in board.sent if line.startswith((b"G", b"$J"))]


class Smoothie(Marlin):
    """A board with Smoothieware, which reports as GRBL does and has no settings to list.

    Smoothieware/Smoothieware: SimpleShell.cpp (on_console_line_received: "error:Invalid statement"), Robot.cpp
    (get_query_string), SimpleShell.cpp (M115).
    """

    def write(self, data, timeout_s):
        if b"?" in data:
            self._out += b"<Idle|MPos:0.0000,0.0000,0.0000|WPos:0.0000,0.0000,0.0000|F:4000.0,100.0>\n"
        *lines, self._line = (self._line + data.replace(b"?", b"")).split(b"\n")
        for line in lines:
            answers = {
                b"$G": b"[GC:G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F4000.0000 S0.8000]\nok\n",
                b"M115": b"FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org\nok\n",
            }
            self._out += answers.get(line, b"error:Invalid statement\n" if line.startswith(b"$") else b"ok\n")


def test_a_board_that_reports_as_grbl_does_and_has_none_of_its_settings_is_named():
    clock = VirtualClock()
    with pytest.raises(UnsupportedError, match=r"the board runs Smoothieware.*GRBL 1.1, grblHAL"):
        GrblStage("stage0", Smoothie(clock, boots=False), clock).connect()


def test_a_controller_that_never_answers_is_given_up_in_time():
    clock = VirtualClock()
    stage = GrblStage("stage0", ScriptedPort(clock, []), clock)
    with pytest.raises(NoAnswerError, match="greeting"):
        stage.connect()
    assert clock.now_s() < 1007.0


def test_a_controller_that_says_nonsense_when_it_is_opened_is_a_bad_reply():
    clock = VirtualClock()
    stage = GrblStage("stage0", ScriptedPort(clock, [b"x" * 600]), clock)
    with pytest.raises(BadReplyError, match="no end of line"):
        stage.connect()


def test_reports_in_inches_are_understood():
    _, _, stage = make(GrblMachine(settings={13: 1}))
    stage.connect()
    assert stage.positions_mm()["x"] == pytest.approx(-100.0, abs=0.03)


def test_work_positions_are_turned_into_machine_positions_with_their_offset():
    _, twin, stage = make()
    stage.connect()
    twin._report = lambda: b"<Idle|WPos:1.000,2.000,3.000|FS:0,0|WCO:-50.000,0.000,0.000>\r\n"
    assert stage.positions_mm()["x"] == pytest.approx(-49.0)
    twin._report = lambda: b"<Idle|WPos:2.000,2.000,3.000|FS:0,0>\r\n"
    assert stage.positions_mm()["x"] == pytest.approx(-48.0)


def test_a_work_position_without_any_offset_is_a_bad_reply_that_names_the_setting():
    _, twin, stage = make()
    twin._report = lambda: b"<Idle|WPos:1.000,2.000,3.000|FS:0,0>\r\n"
    with pytest.raises(BadReplyError, match=r"set \$10=1"):
        stage.connect()


def test_a_report_without_an_axis_in_use_is_a_bad_reply():
    clock = VirtualClock()
    twin = GrblTwin(clock)
    stage = GrblStage("stage0", twin.open(), clock, GrblOptions(axes=("x", "y")))
    stage.connect()
    twin._report = lambda: b"<Idle|MPos:1.000|FS:0,0>\r\n"
    with pytest.raises(BadReplyError, match="no axis y"):
        stage.positions_mm()


@pytest.mark.parametrize("settings_", [{110: 0.0}, {100: -1.0}])
def test_settings_that_no_machine_has_are_a_bad_reply(settings_):
    _, _, stage = make(GrblMachine(settings=settings_))
    with pytest.raises(BadReplyError, match="not positive"):
        stage.connect()


def test_a_missing_setting_is_a_bad_reply():
    _, twin, stage = make()
    del twin._settings[120]
    with pytest.raises(BadReplyError, match=r"\$120 is missing"):
        stage.connect()


def test_an_axis_that_no_controller_has_is_refused():
    with pytest.raises(ValidationError, match="'x', 'y' or 'z'"):
        GrblOptions(axes=("w",))


def test_homing_that_is_disabled_is_refused_with_its_setting():
    _, _, stage = make(GrblMachine(settings={22: 0}))
    stage.connect()
    assert "homing is disabled" in stage.status().warnings[0]
    with pytest.raises(UnsupportedError, match=r"\$22=1"):
        stage.home()


def test_homing_without_a_switch_ends_in_its_alarm_and_can_be_repeated():
    _, twin, stage = make(GrblMachine(homed=False))
    stage.connect()
    twin.faults.inject("grbl.homing_fails")
    with pytest.raises(MoveFailedError, match="ALARM:9"):
        stage.home()
    assert "ALARM:9" in stage.status().faults[0]
    stage.home()
    assert stage.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)


def hit_a_limit(twin, stage):
    twin.faults.inject("grbl.hard_limit")
    with pytest.raises(
        MoveFailedError, match=r"move to .*ALARM:1 \(hard limit hit.*gs2ci devices --rig RIG.toml --home"
    ):
        stage.move_to({"x": -20.0})


def test_a_controller_that_a_hard_limit_has_locked_says_so_and_can_be_homed():
    clock, twin, stage = make()
    stage.connect()
    hit_a_limit(twin, stage)
    assert stage.status() == StageStatus(
        moving=False, referenced=False, faults=("ALARM:1 (hard limit hit; the position is lost)",)
    )
    for call in (stage.positions_mm, lambda: stage.move_to({"x": -20.0}), lambda: stage.wait_idle(1.0)):
        begin_s = clock.now_s()
        with pytest.raises(MoveFailedError, match="ALARM:1"):
            call()
        assert clock.now_s() - begin_s < 0.1
    with pytest.raises(MoveFailedError, match=r"\$G: the device reports ALARM:1"):
        stage._link.command("$G")
    stage.home()
    assert stage.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)


@pytest.mark.parametrize("homing", [0, 1])
@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.49, 0.51, 3.0])
def test_a_stop_unlocks_the_controller_and_the_position_stays_lost(after_s, homing):
    clock, twin, stage = make(GrblMachine(settings={22: homing}))
    stage.connect()
    twin._alarm(1)
    clock.sleep_s(after_s)
    stage.stop()
    stage.stop()
    status = stage.status()
    assert not status.referenced
    assert status.faults == ("ALARM:1 (hard limit hit; the position is lost)",)
    with pytest.raises(ReferenceLostError):
        stage.move_to({"x": -20.0})


@pytest.mark.parametrize("alarm", [1, 2, 3])
@pytest.mark.parametrize("after_s", [0.0, 0.2, 0.6, 3.0])
def test_a_home_after_an_alarm_of_which_nobody_has_heard_resets_first(after_s, alarm):
    clock, twin, stage = make()
    stage.connect()
    twin._alarm(alarm)
    clock.sleep_s(5e-3 + after_s)
    stage.home()
    assert stage.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)


def test_a_session_that_finds_the_controller_locked_resets_it_and_can_home_it():
    clock, twin, stage = make()
    stage.connect()
    hit_a_limit(twin, stage)
    stage.close()
    again = opened(twin, clock)
    again.connect()
    assert "it answered after a soft reset" in again.incidents[-1]
    with pytest.raises(ReferenceLostError):
        again.move_to({"x": -20.0})
    again.home()
    assert again.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)


def test_a_session_that_finds_the_controller_homing_stops_it():
    clock, twin, stage = make()
    stage.connect()
    stage._link.send(b"$H\n", "$H")
    stage.close()
    again = opened(twin, clock)
    again.connect()
    rest = twin.positions_mm_at(clock.now_s())
    clock.sleep_s(1.0)
    assert twin.positions_mm_at(clock.now_s()) == rest
    assert not again.status().referenced


def test_a_homing_that_takes_too_long_is_stopped():
    clock, twin, stage = make()
    stage.connect()
    with pytest.raises(NoAnswerError, match=r"\$H: no answer within 2 s"):
        stage.home(timeout_s=2.0)
    rest = twin.positions_mm_at(clock.now_s())
    clock.sleep_s(1.0)
    assert twin.positions_mm_at(clock.now_s()) == rest
    assert stage.status().faults == ("ALARM:6 (homing: reset)",)
    stage.home()
    assert stage.status().referenced


def test_a_homing_that_is_slow_by_its_settings_is_waited_for():
    clock, _, stage = make(GrblMachine(homed=False, settings={25: 60.0, 130: 400.0, 132: 1.0}))
    stage.connect()
    stage.home()
    assert clock.now_s() > 130.0
    assert stage.status().referenced


def test_a_homing_that_is_refused_resets_nothing():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("grbl.error", value=13)
    with pytest.raises(RefusedError, match=r"\$H: refused with error:13"):
        stage.home()
    assert stage.status().referenced


def test_a_stop_that_is_not_answered_ends_in_a_soft_reset():
    clock, twin, stage = make()
    stage.connect()
    stage.begin_move({"x": -20.0})
    twin.faults.inject("grbl.silent_status", times=2)
    stage.stop()
    rest = twin.positions_mm_at(clock.now_s())
    clock.sleep_s(1.0)
    assert twin.positions_mm_at(clock.now_s()) == rest
    assert not stage.status().referenced


@pytest.mark.parametrize("when_s", [0.0, 1e-4, 1e-3, 2e-3, 0.1, 0.3])
def test_a_limit_that_is_hit_while_a_stop_waits_leaves_a_controller_that_answers(when_s):
    clock, twin, stage = make(GrblMachine(settings={120: 20}))
    stage.connect()
    stage.begin_move({"x": -20.0})
    clock.sleep_s(1.5)
    clock.after(when_s, lambda: twin._alarm(1))
    stage.stop()
    clock.sleep_s(1.0)
    status = stage.status()
    assert not status.moving
    assert status.faults == ("ALARM:1 (hard limit hit; the position is lost)",)
    stage.home()
    assert stage.status().referenced


def test_a_move_after_an_alarm_and_its_restart_is_refused_until_homed():
    clock, twin, stage = make(GrblMachine(settings={22: 0}))
    stage.connect()
    stage.begin_move({"x": -20.0})
    clock.sleep_s(0.5)
    twin._soft_reset()
    clock.sleep_s(2.0)
    stage.stop()
    with pytest.raises(ReferenceLostError):
        stage.move_to({"x": -20.0})


def test_a_restart_is_noticed_by_a_stop_wherever_its_line_is_cut():
    banner = b"\r\nGrbl 1.1h ['$' for help]\r\n"
    idle = b"<Idle|MPos:-1.000,2.000,3.000|FS:0,0>\r\n"
    for cut in range(1, len(banner)):
        clock, twin, stage = make(GrblMachine(settings={22: 0}))
        stage.connect()
        now_s = clock.now_s()
        twin._arrive(idle + banner[:cut], now_s)
        twin._arrive(banner[cut:], now_s + 2e-3)
        clock.sleep_s(0.0)
        stage.stop()
        assert not stage.status().referenced, cut
        with pytest.raises(ReferenceLostError):
            stage.move_to({"x": -20.0})


def test_a_line_that_never_ends_does_not_keep_a_stop_waiting():
    clock, twin, stage = make()
    stage.connect()
    twin._arrive(b"<Idle|MP", clock.now_s())
    begin_s = clock.now_s()
    stage.stop()
    assert clock.now_s() - begin_s < 0.1


def test_an_idle_that_comes_too_early_is_not_taken_for_the_arrival():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("grbl.early_idle")
    assert stage.move_to({"x": -20.0})["x"] == pytest.approx(-20.0)
    assert "reported early" in stage.incidents[-1]


def test_a_refused_jog_names_the_error_and_what_to_do():
    _, twin, stage = make()
    stage.connect()
    twin.faults.inject("grbl.error", value=15)
    with pytest.raises(RefusedError, match=r"beyond the machine's travel.*run-up") as caught:
        stage.move_to({"x": -20.0})
    assert caught.value.code == "error:15"


def test_a_diagonal_keeps_the_speed_of_its_fastest_axis():
    clock = VirtualClock()
    twin = GrblTwin(clock)
    stage = GrblStage("stage0", twin.open(), clock, GrblOptions(axes=("x", "y")))
    stage.connect()
    stage.begin_move({"x": -60.0, "y": -80.0}, speed_mm_s=4.0)
    clock.sleep_s(2.0)
    now_s = clock.now_s()
    moved = [
        a - b
        for a, b in zip(twin.positions_mm_at(now_s).values(), twin.positions_mm_at(now_s - 1).values(), strict=True)
    ]
    assert moved[0] == pytest.approx(4.0, rel=1e-3)
    assert moved[1] == pytest.approx(2.0, rel=1e-3)


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.one_of(
            st.binary(min_size=1, max_size=100),
            st.sampled_from([b"ok\r\n", b"<Idle|MPos:0,0,0>\r\n", b"$100=1\r\n", b"ALARM:1\r\n", b"error:9\r\n"]),
        ),
        max_size=12,
    )
)
def test_a_line_that_babbles_gives_typed_errors_and_never_hangs(answers):
    clock = VirtualClock()
    stage = GrblStage("stage0", ScriptedPort(clock, answers), clock)
    begin_s = clock.now_s()
    with pytest.raises(DriverError):
        stage.connect()
    assert clock.now_s() - begin_s < 10.0


@pytest.mark.parametrize("piece", [b"ok\r\n", b"ALARM:1\r\n", b"Grbl 1.1h ['$' for help]\r\n", b"x" * 256, b"\xff"])
def test_lines_that_never_stop_coming_are_drained_for_a_while_only(piece):
    clock = VirtualClock()
    port = ScriptedPort(clock, [])
    port.read = lambda max_bytes, timeout_s: piece
    begin_s = clock.now_s()
    GrblStage("stage0", port, clock)._link.drain("stop")
    assert clock.now_s() - begin_s < 5.0


def test_a_controller_that_does_not_obey_a_stop_is_reported_in_time():
    clock, twin, stage = make()
    stage.connect()
    twin._report = lambda: b"<Jog|MPos:1.000,2.000,3.000|FS:0,0>\r\n"
    begin_s = clock.now_s()
    with pytest.raises(NoAnswerError, match=r"stop: no answer.*cut the stage's power"):
        stage.stop()
    assert clock.now_s() - begin_s < 10.0


def test_a_refused_dwell_is_told_as_the_refusal_it_is():
    clock = VirtualClock()
    idle = b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n"
    stage = GrblStage("stage0", ScriptedPort(clock, [idle, b"error:1\r\n"]), clock, GrblOptions(axes=("x",)))
    with pytest.raises(RefusedError, match=r"G4 P0.01: refused with error:1 \(expected a command letter\)"):
        stage.wait_idle(1.0)


def test_a_restart_instead_of_an_answer_is_a_lost_reference():
    clock = VirtualClock()
    idle = b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n"
    stage = GrblStage(
        "stage0", ScriptedPort(clock, [idle, b"Grbl 1.1h ['$' for help]\r\n"]), clock, GrblOptions(axes=("x",))
    )
    with pytest.raises(ReferenceLostError, match="the controller restarted"):
        stage.wait_idle(1.0)


def test_a_status_that_nobody_can_read_is_a_bad_reply_when_it_comes_twice():
    _, twin, stage = make()
    stage.connect()
    twin._report = lambda: b"<Dreaming|MPos:1.000,2.000,3.000>\r\n"
    with pytest.raises(BadReplyError, match=r"unknown state 'Dreaming'.*State.MPos"):
        stage.positions_mm()
