"""`gs2ci calibrate` as a user types it, on a small simulated rig."""

import pytest

from gs2ci.core.errors import InputError
from gs2ci_calibration.bundle import Bundle, Provenance, read_bundle, write_bundle
from gs2ci_calibration.procedures import PROCEDURES

RIG = """
[modulator]
kind = "scpi"
[sensor]
kind = "v4l2"
height = 32
width = 48
format = "Y12"
black_level_dn = 64.0
[capture]
masks = 4
[calibration]
frames = 8
temperature_c = 30.0
[world]
scene = "planes"
height = 32
width = 48
"""


def test_steps_fill_a_bundle_and_check_finds_no_drift(rig, capsys, gs2ci):
    for step in ("dark-flat", "sensor"):
        assert gs2ci("calibrate", step, "--rig", rig, "-o", "b.cal.h5") == 0
    said = capsys.readouterr().out
    assert "gain_e_per_dn" in said
    assert "0 hot and 0 dead pixels of 1536" in said
    bundle = read_bundle(rig.with_name("b.cal.h5"))
    assert list(bundle.sections) == ["dark-flat", "sensor"]
    assert bundle.provenance.rig == RIG
    assert bundle.provenance.simulated
    assert bundle.provenance.temperature_c == 30.0
    assert set(bundle.provenance.devices) == {"modulator", "sensor"}
    written = rig.with_name("b.cal.h5").read_bytes()
    assert gs2ci("calibrate", "check", "--rig", rig, "-o", "b.cal.h5") == 0
    told = capsys.readouterr().out
    assert told.index("flat frames: ") < told.index("since the calibration") < told.index("black level")
    assert rig.with_name("b.cal.h5").read_bytes() == written


def test_what_a_step_took_is_said_before_what_it_found(rig, capsys, gs2ci):
    """Not under the name of the step that runs next."""
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "b.cal.h5") == 0
    said = capsys.readouterr().out
    assert said.index("dark-flat:") < said.index("flat frames: ") < said.index("value ± standard error")


def test_check_ends_with_an_error_that_names_what_to_measure_again(rig, capsys, gs2ci):
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "b.cal.h5") == 0
    rig.write_text(RIG + "[world.sensor]\nblack_level_dn = 80.0\n")
    assert gs2ci("calibrate", "check", "--rig", rig, "-o", "b.cal.h5") == 2
    told = capsys.readouterr()
    assert "NO" in told.out
    assert "black level changed by more than allowed" in told.err
    assert "run `gs2ci calibrate` dark-flat again" in told.err


def test_a_refused_step_leaves_the_bundle_as_it_was(rig, capsys, gs2ci):
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "b.cal.h5") == 0
    written = rig.with_name("b.cal.h5").read_bytes()
    rig.write_text(RIG + 'always = "flat"\n')
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "b.cal.h5") == 2
    assert "put the lens cap on" in capsys.readouterr().err
    assert rig.with_name("b.cal.h5").read_bytes() == written


def test_a_place_without_a_folder_is_refused_before_anything_is_measured(rig, capsys, gs2ci):
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "missing/b.cal.h5") == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "not a place for a bundle" in told.err


def test_check_without_a_bundle_says_how_to_make_one(rig, capsys, gs2ci):
    assert gs2ci("calibrate", "check", "--rig", rig, "-o", "b.cal.h5") == 2
    assert "gs2ci calibrate all" in capsys.readouterr().err


def test_all_runs_every_step_that_there_is_in_order_and_no_stage_where_there_is_none(rig, monkeypatch, capsys, gs2ci):
    done = []

    def stand_in(name):
        def measure(bench, known):
            done.append((name, tuple(known.sections)))
            return PROCEDURES_BEFORE[name](bench, known) if name == "dark-flat" else first(known)

        return measure

    def first(known):
        return known.sections["dark-flat"]

    PROCEDURES_BEFORE = {name: step for name, step in PROCEDURES.items() if name != "stage"}
    monkeypatch.setitem(PROCEDURES, "stage", stand_in("stage"))
    for name in PROCEDURES_BEFORE:
        monkeypatch.setitem(PROCEDURES, name, stand_in(name))
    assert gs2ci("calibrate", "all", "--rig", rig, "-o", "b.cal.h5") == 0
    assert [name for name, _ in done] == list(PROCEDURES_BEFORE)
    assert done[0] == ("dark-flat", ())
    assert "no stage: its step is left out" in capsys.readouterr().out


@pytest.mark.parametrize("place", ["b.txt", "nowhere/b.cal.h5"])
def test_a_place_that_cannot_hold_a_bundle_is_refused_before_any_frame_is_taken(rig, capsys, gs2ci, monkeypatch, place):
    monkeypatch.setitem(PROCEDURES, "dark-flat", None)
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", place) == 2
    assert "not a place for a bundle" in capsys.readouterr().err


def test_a_bundle_of_other_devices_is_refused_before_any_frame_is_taken(rig, capsys, gs2ci, monkeypatch):
    write_bundle(rig.with_name("b.cal.h5"), Bundle(Provenance(devices={"sensor": ("another", "7", "v1")})))
    monkeypatch.setitem(PROCEDURES, "dark-flat", None)
    assert gs2ci("calibrate", "dark-flat", "--rig", rig, "-o", "b.cal.h5") == 2
    assert "belongs to another 7, the bench has" in capsys.readouterr().err


def test_what_is_done_when_a_later_step_fails_is_said_with_how_to_go_on(rig, capsys, gs2ci, monkeypatch):
    def fails(bench, bundle):
        raise InputError("no board")

    monkeypatch.setitem(PROCEDURES, "sensor", fails)
    assert gs2ci("calibrate", "all", "--rig", rig, "-o", "b.cal.h5") == 2
    said = capsys.readouterr().out
    again = f"gs2ci calibrate sensor --rig {rig} -o b.cal.h5"
    left = "(sensor, registration, masks, camera, timing are left)"
    assert f"in b.cal.h5: dark-flat; go on with `{again}` {left}" in said
    assert list(read_bundle(rig.with_name("b.cal.h5")).sections) == ["dark-flat"]
