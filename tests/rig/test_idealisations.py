"""What the twins leave out: the list, the rig file's keys and the twins say the same."""

import numpy as np
import pytest

from gs2ci.core.mechanics import Mechanics
from gs2ci.core.progress import Silent
from gs2ci.core.storage import read_shot
from gs2ci.rig.config import WorldTable
from gs2ci.rig.opening import load_rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench, with_typical_devices
from gs2ci_drivers.failures import ReferenceLostError
from gs2ci_sims.idealisations import IDEALISATIONS, typical
from gs2ci_sims.rig_file import effects_from_tables
from gs2ci_sims.stated import Stated

RIG = """
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
[sensor]
kind = "v4l2"
height = 40
width = 60
format = "Y12"
trigger_adapter = "control"
[stage]
kind = "grbl"
axes = ["x"]
[stage.mount]
[capture]
masks = 2
mask_s = 0.02
axis = "x"
from_mm = -100.0
to_mm = -99.0
[world]
scene = "planes"
height = 40
width = 60
"""
SWITCHED = [one for one in IDEALISATIONS if one.key]


@pytest.fixture
def rig_with(tmp_path):
    def read(more):
        file = tmp_path / "bench.toml"
        file.write_text(RIG + more, encoding="utf-8")
        return load_rig(file)

    return read


@pytest.mark.parametrize("one", SWITCHED, ids=lambda one: one.key)
def test_a_switch_is_a_key_of_the_rig_file_whose_default_is_the_ideal(one):
    table, _, name = one.key.rpartition(".")
    if table:
        assert table == "effects"
        assert one.ideal is None
        assert name not in WorldTable().effects
        if one.typical is not None:
            (effect,) = effects_from_tables({name: one.typical})
            assert effect.name == name
    else:
        assert getattr(WorldTable(), name) == one.ideal
        if one.typical is not None:
            assert getattr(WorldTable(**{name: one.typical}), name) == one.typical != one.ideal


def test_the_mechanics_of_an_axis_are_perfect_unless_the_file_says_otherwise():
    stated = Stated(WorldTable(mechanics={"x": Mechanics(scale=1.01)}))
    assert stated.mechanics("x") == Mechanics(scale=1.01) != Mechanics()
    assert stated.mechanics("y") == Stated().mechanics("x") == Mechanics()


def test_typical_devices_are_what_the_list_says_and_only_those_that_the_rig_has(rig_with):
    world = with_typical_devices(rig_with('devices = "typical"').table).world
    for one in typical({"dlpc900", "v4l2", "grbl"}):
        table, _, name = one.key.rpartition(".")
        assert (world.effects[name] if table else getattr(world, name)) == one.typical
    assert world.panel_response_s == 0.0  # there is no panel


def test_what_the_rig_file_says_itself_goes_before_what_is_typical(rig_with):
    more = 'devices = "typical"\ncamera_clock_ppm = 7.0\n[world.effects.mask_edges]\nsigma_px = 0.1\n'
    world = with_typical_devices(rig_with(more).table).world
    assert world.camera_clock_ppm == 7.0
    assert world.effects["mask_edges"] == {"sigma_px": 0.1}
    assert world.trigger_latency_s == 5e-6


def test_devices_are_typical_unless_the_rig_file_says_otherwise(rig_with):
    assert with_typical_devices(rig_with("").table).world.effects.keys() == {
        "finite_contrast",
        "mask_edges",
        "mirror_transition",
    }


def test_ideal_devices_are_left_as_they_are(rig_with):
    table = rig_with('devices = "ideal"').table
    assert with_typical_devices(table) is table


def test_the_twins_are_built_as_typical_devices_are(rig_with):
    ideal, real = (build_bench(rig_with(f'devices = "{kind}"').table) for kind in ("ideal", "typical"))
    assert [bench.sensor.model.clock_ppm for bench in (ideal, real)] == [0.0, 40.0]
    assert [bench.sensor.model.stamps for bench in (ideal, real)] == ["start-of-exposure", "start-of-frame"]
    named = [{effect.name for effect in bench.light.effects} for bench in (ideal, real)]
    assert named[0] == set()
    assert named[1] == {"finite_contrast", "mask_edges", "mirror_transition"}


def test_a_bench_whose_uno_was_just_plugged_in_takes_a_shot_once_its_stage_was_homed(rig_with, tmp_path):
    rig = rig_with('grbl_board = "uno"')
    devices = rig.open()
    try:
        with pytest.raises(ReferenceLostError):  # opening the port has reset the Uno
            record(rig, devices, prepare(rig, devices), tmp_path / "early.h5", replace=False, progress=Silent())
        devices.stage.home()
        record(rig, devices, prepare(rig, devices), tmp_path / "shot.h5", replace=False, progress=Silent())
    finally:
        devices.close()
    shot = read_shot(tmp_path / "shot.h5")
    assert np.isfinite(shot.measurement).all()
    assert shot.masks.shape == (2, 40, 60)
