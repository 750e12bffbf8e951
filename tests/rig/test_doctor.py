from dataclasses import replace
from types import SimpleNamespace

import pytest

from gs2ci.rig import doctor
from gs2ci.rig.config import RigTable
from gs2ci.rig.doctor import examine
from gs2ci.rig.intent import intended
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.manners import manners_of
from gs2ci_drivers.sensor import TriggerMode
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.trigger import ControlTrigger
from gs2ci_sims.wires.shutter import Shutting
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.world import Darkness

TABLES = {
    "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables", "reply_timeout_s": 1.0},
    "sensor": {"kind": "v4l2", "format": "Y12"},
    "stage": {"kind": "zaber"},
    "world": {"height": 48, "width": 64},
}


def make(tmp_path, **changes):
    table = RigTable.model_validate({name: {**rows, **changes.get(name, {})} for name, rows in TABLES.items()})
    return Rig(table, "", tmp_path, build_bench(table, Darkness()))


def verdicts(rig, **options):
    return {finding.what: finding for finding in examine(rig, **options)}


def test_a_healthy_bench_has_no_bad_finding_and_nothing_moves(tmp_path):
    rig = make(tmp_path)
    stage = rig.bench.stage
    before = stage.positions_mm_at(rig.clock.now_s())
    found = verdicts(rig)
    assert {finding.verdict for finding in found.values()} == {"ok", "know"}
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail
    assert stage.positions_mm_at(rig.clock.now_s()) == before


@pytest.mark.parametrize(
    ("device", "fault", "what", "words"),
    [
        ("sensor", "v4l2.trigger_missed", "trigger pulses", "check the trigger cable"),
        ("sensor", "v4l2.trigger_doubled", "trigger pulses", "check the trigger cable"),
        ("modulator", "dlpc900.parked", "modulator state", "manual"),
        ("stage", "serial.unplugged", "stage", "plug it in again"),
    ],
)
def test_each_trouble_is_found_with_its_remedy(tmp_path, device, fault, what, words):
    rig = make(tmp_path)
    rig.bench.faults[device].inject(fault)
    finding = verdicts(rig)[what]
    assert finding.verdict == "bad"
    assert words in finding.remedy


def test_an_unreferenced_stage_is_found_and_the_others_still_examined(tmp_path):
    rig = make(tmp_path)
    rig.bench.stage.power_cycle()
    found = verdicts(rig)
    assert "home it" in found["stage reference"].remedy
    assert found["trigger loop"].verdict == "ok"


def test_a_camera_without_external_trigger_is_found(tmp_path):
    found = verdicts(make(tmp_path, sensor={"trigger_adapter": "none"}))
    assert "trigger_adapter" in found["sensor trigger"].remedy
    assert found["trigger loop"].verdict == "bad"


@pytest.mark.parametrize("adapter", ["outside", "module", "control"])
def test_a_camera_that_runs_by_its_own_clock_is_not_taken_for_a_triggered_one(tmp_path, adapter):
    """What a setting says is no proof: an imx477 whose parameter is 1 drives the line instead of following it."""
    sensor = {"trigger_adapter": adapter, "trigger_module": "imx477"}
    sensor |= (
        {}
        if adapter == "outside"
        else {"trigger_values": {"free-run": 0, "edge": {"module": 1, "control": 3}[adapter]}}
    )
    rig = make(tmp_path, sensor=sensor)
    model = replace(rig.bench.sensor.model, outside=Shutting.FREE, module="imx477")
    rig.bench.sensor = V4l2Twin(rig.bench.world, model, rig.bench.faults["sensor"])
    waits = verdicts(rig)["sensor waits"]
    assert waits.verdict == "bad"
    assert "runs by its own clock" in waits.detail
    assert ("by the means that you use" if adapter == "outside" else "trigger_values") in waits.remedy


def test_a_camera_that_was_switched_outside_is_proved_by_the_doctor(tmp_path):
    found = verdicts(make(tmp_path, sensor={"trigger_adapter": "outside"}))
    assert (found["sensor waits"].verdict, found["trigger pulses"].verdict) == ("ok", "ok")
    assert "without a trigger" in found["sensor waits"].detail


def test_a_sensor_that_fails_while_it_waits_is_a_finding(tmp_path):
    rig = make(tmp_path)
    rig.bench.faults["sensor"].inject("v4l2.call_fails", value=5, about="VIDIOC_STREAMON")
    assert verdicts(rig)["sensor waits"].verdict == "bad"


def test_an_unplugged_device_ends_the_examination_with_one_finding(tmp_path):
    rig = make(tmp_path)
    rig.bench.modulator.unplug()
    found = verdicts(rig)
    assert found["opening the ports"].verdict == "bad"


def test_the_loop_can_be_left_out(tmp_path):
    assert "trigger loop" not in verdicts(make(tmp_path), trigger_loop=False)


def test_missing_nodes_and_permissions_are_found_with_the_udev_rule(tmp_path, monkeypatch):
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables", "port": "usb"},
            "sensor": {"kind": "v4l2", "port": str(tmp_path / "video9")},
            "stage": {"kind": "zaber", "port": str(tmp_path / "tty9")},
        }
    )
    (tmp_path / "tty9").write_text("")
    monkeypatch.setattr(doctor.os, "access", lambda path, how: False)
    found = {finding.what: finding for finding in doctor._permissions(Rig(table, "", tmp_path))}
    assert 'ATTRS{idVendor}=="0451"' in found["permissions for the modulator"].remedy
    assert "does not exist" in found["permissions for the sensor"].detail
    assert 'SUBSYSTEM=="tty", KERNEL=="tty9"' in found["permissions for the stage"].remedy


def test_the_rule_for_a_serial_device_opens_no_other_one(tmp_path, monkeypatch):
    usb = SimpleNamespace(device=str(tmp_path / "ttyUSB3"), vid=0x0403, pid=0x6001, serial_number="A7")
    monkeypatch.setattr(doctor.list_ports, "comports", lambda: [usb])
    (tmp_path / "ttyUSB3").write_text("")
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB3")
    rule = doctor.tty_rule(str(tmp_path / "by-id"))
    assert 'ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6001", ATTRS{serial}=="A7"' in rule
    usb.serial_number = None
    assert "serial" not in doctor.tty_rule(str(tmp_path / "by-id"))
    assert 'KERNEL=="ttyS0"' in doctor.tty_rule("/dev/ttyS0")


@pytest.mark.parametrize(("stretch", "verdict"), [(1.0, "ok"), (1.0001, "ok"), (1.002, "bad")])
def test_clocks_that_disagree_are_found(stretch, verdict):
    stamps = [round(i * 0.05e9 * stretch) for i in range(8)]
    assert doctor._clock(True, lambda: stamps, 0.05).verdict == verdict
    assert doctor._clock(False, lambda: stamps, 0.05).verdict == "note"


def test_a_panel_behind_usb_is_given_its_own_udev_rule(tmp_path):
    table = RigTable.model_validate(
        {"modulator": {"kind": "santec", "port": "usb"}, "sensor": {"kind": "v4l2", "port": str(tmp_path / "video9")}}
    )
    found = {finding.what: finding for finding in doctor._permissions(Rig(table, "", tmp_path))}
    assert found["permissions for the modulator"].verdict == "note"
    assert 'ATTRS{idVendor}=="0403"' in found["permissions for the modulator"].remedy


def test_what_one_would_not_guess_of_the_devices_found_is_told(tmp_path):
    table = RigTable.model_validate(
        {
            "modulator": {"kind": "alp"},
            "sensor": {"kind": "v4l2"},
            "stage": {"kind": "kinesis"},
            "world": {"height": 8, "width": 16},
        }
    )
    rig = Rig(table, "", tmp_path, build_bench(table, Darkness()))
    rig.bench.stage.unplug()
    rig.bench.stage.plug_in()
    told = [
        one.detail
        for one in doctor.examine(rig, trigger_loop=False)
        if (one.what, one.verdict) == ("about the stage", "know")
    ]
    assert told == [f"{one.applies}: not “{one.guess}”, but: {one.fact}" for one in manners_of("kinesis")]
    devices = rig.open()
    rig.bench.stage.faults.inject("serial.request_lost", times=99)
    devices.close()
    found = list(doctor.examine(rig, trigger_loop=False))
    assert {one.what for one in found if one.verdict == "know"} == {"about the modulator", "about the sensor"}


def test_the_library_of_a_vialux_device_is_looked_for(tmp_path):
    def said():
        modulator = {"kind": "alp", "port": "usb", "library": str(tmp_path)}
        table = RigTable.model_validate({"modulator": modulator, "sensor": {"kind": "v4l2", "port": "/dev/null"}})
        (found,) = [one for one in doctor._permissions(Rig(table, "", tmp_path)) if one.what == "maker's library"]
        return found.verdict, found.detail, found.remedy

    verdict, detail, remedy = said()
    assert (verdict, "libalp43.so does not exist" in detail) == ("bad", True)
    assert "`library`" in remedy
    (tmp_path / "libalp43.so").touch()
    assert said() == ("ok", str(tmp_path / "libalp43.so"), "")


@pytest.mark.parametrize("fault", ["v4l2.frame_noisy", "v4l2.frame_corrupt", "v4l2.frame_dropped"])
def test_a_camera_that_runs_freely_and_sends_bad_frames_only_does_not_keep_the_doctor(tmp_path, monkeypatch, fault):
    set_mode = ControlTrigger.set_mode
    monkeypatch.setattr(ControlTrigger, "set_mode", lambda adapter, mode: set_mode(adapter, TriggerMode.FREE_RUN))
    rig = make(tmp_path)
    rig.bench.faults["sensor"].inject(fault, times=10_000)
    before_s = rig.clock.now_s()
    found = verdicts(rig)
    assert found["trigger pulses"].verdict == found["trigger loop"].verdict == "bad"
    assert rig.clock.now_s() - before_s < 60


def test_the_doctor_examines_the_camera_as_the_capture_sets_it_up(tmp_path, monkeypatch):
    sensor = {"gain_db": 6.0, "gain_db_per_unit": 0.1, "controls": {"analogue_gain": 70}}
    rig, configs = make(tmp_path, sensor=sensor), []
    devices = rig.open()
    *_, wanted = intended(rig, devices)
    devices.close()
    do_configure = V4l2Sensor._do_configure
    monkeypatch.setattr(
        V4l2Sensor, "_do_configure", lambda camera, config: configs.append(config) or do_configure(camera, config)
    )
    assert {finding.verdict for finding in examine(rig)} == {"ok", "know"}
    assert len(configs) == 6  # without triggers, pulses twice, loop, stamps twice
    assert {str(replace(one, exposure_s=0, trigger=TriggerMode.EDGE)) for one in configs} == {
        str(replace(wanted, exposure_s=0, trigger=TriggerMode.EDGE))
    }
    assert wanted.gain_db == 6.0
    assert wanted.controls == {"analogue_gain": 70}
