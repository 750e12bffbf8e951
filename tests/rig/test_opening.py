import os
import subprocess
import sys
import types
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig import discovery
from gs2ci.rig.calibrating import operator_of
from gs2ci.rig.config import RigTable, WorldTable
from gs2ci.rig.opening import Rig, load_rig
from gs2ci.rig.simulated import build_bench, scene_of
from gs2ci_drivers.failures import AccessError, DisconnectedError, WrongStateError
from gs2ci_drivers.plugin import BUILT_IN, PluginError, driver_plugin, known_driver
from gs2ci_sims.stated import Stated
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.wires.v4l2_camera import CameraModel
from gs2ci_sims.world import Darkness, World
from tests.bench_truth import truth_of


def simulated(tmp_path, **tables):
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables"},
            "sensor": {"kind": "v4l2"},
            "world": {"height": 8, "width": 16},
        }
        | tables
    )
    return Rig(table, "", tmp_path, build_bench(table, Darkness()))


@pytest.mark.parametrize("modulator", ["dlpc900", "scpi", "santec", "alp"])
@pytest.mark.parametrize("stage", ["zaber", "grbl", "kinesis"])
def test_every_kind_opens_on_its_twin_and_can_be_opened_again(tmp_path, modulator, stage):
    rig = simulated(tmp_path, modulator={"kind": modulator}, stage={"kind": stage})
    for _ in range(2):
        devices = rig.open()
        assert devices.modulator.connect().model
        assert devices.sensor.connect().formats
        assert devices.stage.connect().axes
        devices.close()


@pytest.mark.parametrize(
    ("kind", "form", "bits"),
    [
        ("v4l2", "GREY", 8),
        ("v4l2", "Y10", 10),
        ("v4l2", "RG12", 12),
        ("v4l2", "Y16", 16),
        ("v4l2", "", 12),
        ("genicam", "Mono8", 8),
        ("genicam", "Mono10p", 10),
        ("genicam", "BayerRG12p", 12),
        ("genicam", "", 12),
    ],
)
def test_figures_of_a_simulated_sensor_are_in_readings_of_its_format(kind, form, bits):
    """Black level and full well are read as the rig file states them, whatever the depth."""
    black_dn, full_well_e = 2.0 ** (bits - 6), 9_000.0
    sensor = {"kind": kind, "format": form, "black_level_dn": black_dn, "full_well_e": full_well_e}
    table = {
        "modulator": {"kind": "scpi"},
        "sensor": sensor | {"electrons_per_dn": full_well_e / (0.75 * 2**bits)},
        "world": {"height": 8, "width": 16, "scene": "planes", "devices": "ideal", "noise": False},
    }
    bench = build_bench(RigTable.model_validate(table))
    end_s = bench.world.clock.now_s()
    bench.light.look_at_nothing()
    dark = bench.world.integrate(end_s - 0.01, end_s, height=8, width=16, bits=bits)
    assert np.abs(dark - black_dn).max() <= 0.5
    assert bench.light._sensor_of(bits).dn_from_electrons(full_well_e) == pytest.approx(black_dn + 0.75 * 2**bits)
    stated = table | {"world": table["world"] | {"sensor": {"black_level_dn": 100.0, "electrons_per_dn": 2.0}}}
    true = build_bench(RigTable.model_validate(stated)).light._sensor_of(12)
    assert (true.black_level_dn, true.electrons_per_dn) == (100.0, 2.0)


@pytest.mark.parametrize(("group", "kind"), [(group, kind) for group, kinds in BUILT_IN.items() for kind in kinds])
def test_a_built_in_device_is_one_record_as_a_plug_in_is(group, kind, monkeypatch):
    monkeypatch.setattr("gs2ci_drivers.plugin.load", lambda *_: 7)  # no package can take its kind
    record = driver_plugin(group, kind)
    assert record.settings.model_fields["kind"].annotation == Literal[kind]
    assert (record.access == "usb") == (record.usb_ids is not None)
    twin = record.simulated(
        World(stated=Stated(WorldTable(height=8, width=16))), record.settings.model_validate({"kind": kind})
    )
    twin.unplug()
    twin.plug_in()
    assert (record.size is None) == (group != "gs2ci.modulators")


@pytest.mark.parametrize("kind", BUILT_IN["gs2ci.modulators"])
def test_the_size_that_a_record_states_is_that_of_the_device(tmp_path, kind):
    devices = simulated(tmp_path, modulator={"kind": kind}).open()
    info = devices.modulator.connect()
    devices.close()
    assert (info.height, info.width) == known_driver("gs2ci.modulators", kind).size


def test_a_kind_whose_package_is_gone_is_refused():
    with pytest.raises(PluginError, match=r"no driver of the kind 'lamp-array'.*zaber"):
        known_driver("gs2ci.stages", "lamp-array")


def test_what_was_opened_is_closed_again_when_a_later_port_fails(tmp_path):
    rig = simulated(tmp_path, stage={"kind": "zaber"})
    rig.bench.stage.unplug()
    with pytest.raises(DisconnectedError, match="stage"):
        rig.open(tmp_path / "run")
    rig.bench.stage.plug_in()
    rig.open().close()  # the modulator's port was let go of, else it would be busy


def test_a_device_that_fails_to_close_does_not_keep_the_others_open(tmp_path, monkeypatch):
    rig = simulated(tmp_path, stage={"kind": "zaber"})
    devices = rig.open()

    def stuck():
        raise OSError("stuck")

    monkeypatch.setattr(devices.stage, "close", stuck)
    with pytest.raises(OSError, match="stuck"):
        devices.close()
    with pytest.raises(WrongStateError, match="closed"):
        devices.sensor.connect()
    with pytest.raises(WrongStateError, match="closed"):
        devices.modulator.connect()


def test_a_device_that_is_in_use_says_so(tmp_path):
    rig = simulated(tmp_path)
    first = rig.open()
    with pytest.raises(AccessError, match="modulator"):
        rig.open()
    first.close()


def test_ports_that_are_not_there_are_an_access_error_with_a_remedy(tmp_path):
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "scpi", "port": str(tmp_path / "tty0")},
            "sensor": {"kind": "v4l2", "port": "/dev/video0"},
        }
    )
    with pytest.raises(AccessError, match="gs2ci doctor"):
        Rig(table, "", tmp_path).open()


def test_a_rig_file_is_loaded_with_its_bench(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(
        '[modulator]\nkind = "dlpc900"\n[sensor]\nkind = "v4l2"\n[world]\nscene = "planes"\nheight = 8\nwidth = 16\n'
    )
    rig = load_rig(path)
    assert rig.bench is not None
    assert rig.clock is rig.bench.world.clock
    with pytest.raises(InputError, match="1 or more"):
        rig.set_shots(0)
    rig.set_shots(7)
    assert rig.table.capture.shots == 7
    with pytest.raises(InputError, match="--seed -1"):
        rig.set_seed(-1)
    rig.set_seed(5)
    assert rig.table.capture.seed == 5
    masks_of_a_file = rig.table.capture.model_copy(update={"pattern_file": "masks.npy"})
    rig.table = rig.table.model_copy(update={"capture": masks_of_a_file})
    with pytest.raises(InputError, match=r"--seed 5 with pattern_file"):
        rig.set_seed(5)


@pytest.mark.parametrize(("burst", "shots", "shorter"), [(1, 4, 1), (4, 1, 1), (4, 4, 4), (4, 8, 4), (4, 2, 2)])
def test_a_burst_is_no_longer_than_the_shots_that_are_asked_for(tmp_path, burst, shots, shorter):
    table = RigTable.model_validate(
        {"modulator": {"kind": "dlpc900"}, "sensor": {"kind": "v4l2"}, "capture": {"shots": 4, "burst": burst}}
    )
    rig = Rig(table, "", tmp_path)
    rig.set_shots(shots)
    assert (rig.table.capture.shots, rig.table.capture.burst) == (shots, shorter)


REAL = """
import sys
from pathlib import Path
from typing import Literal
import gs2ci.rig.calibrated, gs2ci.rig.calibrating, gs2ci.rig.doctor, gs2ci.rig.recording
from gs2ci.rig.opening import load_rig

assert load_rig(Path(sys.argv[1])).bench is None
sys.exit(" ".join(name for name in ("gs2ci_sims", "gs2ci.rig.simulated") if name in sys.modules) or None)
"""


def test_a_real_bench_does_without_the_simulator():
    rig = Path(__file__).parents[2] / "docs" / "rigs" / "real.toml"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-c", REAL, str(rig)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def no_session(monkeypatch):
    """Let the computer have no video output, whatever it has."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.usefixtures("no_session")
def test_cameras_serial_ports_and_modulators_are_found(monkeypatch):
    port = types.SimpleNamespace(device="/dev/ttyUSB3", description="a bridge")
    board = types.SimpleNamespace(bus=1, port_numbers=(2, 3))
    monkeypatch.setattr(discovery.list_ports, "comports", lambda: [port])
    monkeypatch.setattr(discovery.usb.core, "find", lambda **ids: [board])
    found = discovery.find_devices(V4l2Twin(World(), CameraModel()))
    assert found == [
        ("modulator", "usb:1-2.3", "TI DLPC900"),
        ("sensor", "/dev/video0", "Twin camera (twin)"),
        ("serial", "/dev/ttyUSB3", "a bridge"),
    ]


@pytest.mark.usefixtures("no_session")
def test_a_computer_without_libusb_still_lists_the_rest(monkeypatch):
    def fail(**ids):
        raise discovery.usb.core.NoBackendError("no libusb")

    monkeypatch.setattr(discovery.list_ports, "comports", list)
    monkeypatch.setattr(discovery.usb.core, "find", fail)
    assert [kind for kind, _, _ in discovery.find_devices(V4l2Twin(World(), CameraModel()))] == ["sensor"]


def test_a_bench_whose_light_a_test_put_in_has_neither_operator_nor_truth(tmp_path):
    rig = simulated(tmp_path)
    with pytest.raises(InputError, match="no light to calibrate by"):
        operator_of(rig, str)
    with pytest.raises(InputError, match="has no truth"):
        truth_of(rig.bench, 12)


def test_a_bench_sees_any_scene_of_the_library_or_of_a_file_that_stands_still(tmp_path):
    pytest.importorskip("torch")
    (tmp_path / "own.toml").write_text(
        'name = "own"\n[geometry]\nkind = "boxes"\nseed = 5\ncount = 2\n[path]\nviews = 4\nparallax_px = 3\n'
    )
    rig = '[modulator]\nkind = "dlpc900"\n[sensor]\nkind = "v4l2"\n[world]\nscene = "%s"\nheight = 8\nwidth = 16\n'
    path = tmp_path / "rig.toml"
    for which, name in (("corridor", "corridor"), ("own.toml", "own")):
        path.write_text(rig % which)
        scene = scene_of(load_rig(path).table.world)
        assert (scene.name, scene.size) == (name, (8, 16))
    for which, why in (("coridor", "did you mean 'corridor'"), ("moving", "moves"), ("none.toml", "none.toml")):
        path.write_text(rig % which)
        with pytest.raises(InputError, match=why):
            load_rig(path)
