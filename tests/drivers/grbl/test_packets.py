import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci_drivers.grbl.packets import (
    ALARMS,
    ERRORS,
    is_banner,
    jog,
    parse_code,
    parse_setting,
    parse_status,
)


def test_a_status_report_of_the_manual_is_read():
    status = parse_status("<Idle|MPos:0.000,-1.250,3.000|FS:0,0|WCO:0.000,1.500,7.500|Bf:15,128|Pn:XYZ|Ov:100,100,100>")
    assert (status.state, status.substate) == ("Idle", None)
    assert status.machine == (0.0, -1.25, 3.0)
    assert status.offset == (0.0, 1.5, 7.5)
    assert status.pins == "XYZ"
    assert status.fields["Bf"] == "15,128"


@pytest.mark.parametrize(
    ("text", "state", "substate"), [("Hold:0", "Hold", 0), ("Door:3", "Door", 3), ("Jog", "Jog", None)]
)
def test_sub_states_are_told_from_states(text, state, substate):
    status = parse_status(f"<{text}|WPos:1.000,2.000,3.000|FS:500,0>")
    assert (status.state, status.substate, status.machine, status.work) == (state, substate, None, (1.0, 2.0, 3.0))


def test_grblhals_reports_of_eight_axes_and_of_a_door_that_closes_are_read():
    status = parse_status("<Door:4|MPos:1.000,2.000,3.000,4.000,5.000,6.000,7.000,8.000|FS:0,0>")
    assert status.machine == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
    assert status.moving  # Parking_Resuming (grblHAL/core f80fc34, system.h)


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("Idle|MPos:0,0,0", "stands in < >"),
        ("<Dancing|MPos:0,0,0>", "unknown state"),
        ("<Hold:x|MPos:0,0,0>", "unknown state"),
        ("<Idle|FS:0,0>", "no MPos and no WPos"),
        ("<Idle|MPos:a,b,c>", "could not convert"),
        ("<Idle|MPos:nan,0,0>", "not a position"),
    ],
)
def test_reports_that_are_none_are_refused(line, complaint):
    with pytest.raises(ValueError, match=complaint):
        parse_status(line)


@given(st.text(max_size=120))
def test_any_text_is_a_status_or_a_value_error(text):
    for line in (text, f"<{text}>", f"<Idle|{text}>", f"<Idle|MPos:{text}>"):
        try:
            parse_status(line)
        except ValueError:
            continue


@given(st.text(max_size=40))
def test_any_text_is_a_setting_a_code_a_banner_or_nothing(text):
    for line in (text, f"${text}", f"error:{text}", f"ALARM:{text}", f"Grbl 1.1{text}"):
        setting = parse_setting(line)
        assert setting is None or isinstance(setting[1], float)
        code = parse_code(line)
        assert code is None or code[0] in ("error", "ALARM")
        assert is_banner(line) in (True, False)


def test_settings_codes_and_banners_of_the_manual_are_read():
    assert parse_setting("$110=1800.000") == (110, 1800.0)
    assert parse_setting("$$=1") is None
    assert parse_code("error:15") == ("error", 15)
    assert parse_code("ALARM:1") == ("ALARM", 1)
    assert parse_code("error:Max travel exceeded during jog") == ("error", 15)
    assert parse_code("error:") == ("error", 0)
    assert parse_code("ok") is None
    assert is_banner("Grbl 1.1h ['$' for help]")
    assert not is_banner("[MSG:'$H'|'$X' to unlock]")


def test_a_jog_is_in_machine_coordinates_millimetres_and_absolute():
    assert jog({"x": -12.5, "y": -3.0625}, 600.0) == "$J=G53 G21 G90 X-12.5000 Y-3.0625 F600"


def test_a_jog_longer_than_a_controller_takes_is_refused():
    with pytest.raises(ValueError, match="at most 80"):
        jog({"x": -1e30, "y": -1e30}, 1.0)


def test_alarms_and_errors_of_the_reference_have_words():
    assert set(range(1, 23)) == set(ALARMS)
    assert {1, 2, 3, 5, 8, 9, 11, 15, 16, 20, 22, 33} <= set(ERRORS)
