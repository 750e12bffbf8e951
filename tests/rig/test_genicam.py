"""A bench with a GenICam camera: opened, traced, examined, found."""

import json

import pytest

from gs2ci.core.errors import Gs2ciError
from gs2ci.rig import discovery
from gs2ci.rig.config import RigTable
from gs2ci.rig.doctor import examine
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.links import gentl
from gs2ci_drivers.ports import CameraIdentity, FeatureRefusalError
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from gs2ci_drivers.trace import Trace
from gs2ci_drivers.trace_camera import TracedCamera
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.genicam import GenicamTwin
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.wires.v4l2_camera import CameraModel
from gs2ci_sims.world import Darkness, World
from tests.drivers.replay import call_of

TABLES = {
    "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables", "reply_timeout_s": 1.0},
    "sensor": {"kind": "genicam", "format": "Mono12p"},
    "world": {"height": 48, "width": 64},
}


def make(tmp_path, **changes):
    table = RigTable.model_validate({name: {**rows, **changes.get(name, {})} for name, rows in TABLES.items()})
    return Rig(table, "", tmp_path, build_bench(table, Darkness()))


def test_the_doctor_finds_nothing_wrong_and_says_what_stamps_mean(tmp_path):
    found = {finding.what: finding for finding in examine(make(tmp_path))}
    assert [one for one in found.values() if one.verdict == "bad"] == []
    assert "start-of-exposure" in found["time stamps"].detail


@pytest.mark.parametrize(("driver", "meaning"), [("unicam", "start-of-frame"), ("other", "end-of-frame")])
def test_a_camera_that_stamps_later_than_the_rig_file_says_is_found(tmp_path, driver, meaning):
    rig = make(tmp_path, world={"camera_driver": driver, "camera_readout_s": 0.02})
    found = {finding.what: finding for finding in examine(rig)}["time stamps"]
    assert (found.verdict, found.remedy) == ("bad", f'set stamps = "{meaning}" in [sensor]')


def test_what_passes_the_port_is_written_down(tmp_path):
    rig = make(tmp_path)
    devices = rig.open(tmp_path / "run.h5")
    devices.sensor.connect()
    devices.sensor.configure(SensorConfig(exposure_s=2e-3, trigger=TriggerMode.FREE_RUN))
    devices.sensor.start()
    pixels = devices.sensor.read(1.0).pixels
    devices.close()
    lines = (tmp_path / "run.h5.sensor.wire").read_text().splitlines()
    assert json.loads(lines[0])["port"] == "camera"
    calls = [call_of(line) for line in lines[1:]]
    ops = {call.op for call in calls}
    assert ops >= {"open", "describe", "read", "write", "execute", "start", "fetch", "stop", "clock_ns", "close"}
    (frame,) = [call for call in calls if call.got]
    assert len(frame.got[0]) == pixels.size * 12 // 8
    assert json.loads(frame.result[0])["frame_id"] == 1


def test_a_refusal_is_written_down_and_passed_on(tmp_path):
    world, faults = World(), FaultSet()
    trace = Trace(tmp_path / "x.wire", "sensor", "camera", world.clock)
    port = TracedCamera(GenicamTwin(world, None, faults), trace)
    assert [one.model for one in port.list_cameras("")] == ["Sfnc 2.7"]
    port.open("", "")
    faults.inject("genicam.feature_refused")
    with pytest.raises(FeatureRefusalError, match="Gain"):
        port.write("Gain", 1.0)
    with pytest.raises(FeatureRefusalError, match="no command"):
        port.execute("Gain")
    with pytest.raises(FeatureRefusalError, match="cannot be read"):
        port.read("TimestampLatch")
    for call, about in (
        (lambda: port.start(4, ()), "AcquisitionStart"),
        (lambda: port.fetch(0.1), "fetch"),
        (port.stop, "AcquisitionStop"),
    ):
        faults.inject("genicam.feature_refused", about=about)
        with pytest.raises(FeatureRefusalError, match=about):
            call()
    port.close()
    trace.close()
    errors = [call_of(line).error for line in (tmp_path / "x.wire").read_text().splitlines()[1:]]
    assert [text for text in errors if text] == [
        "Gain: access denied",
        "Gain is no command",
        "TimestampLatch cannot be read",
        "AcquisitionStart: access denied",
        "fetch: access denied",
        "AcquisitionStop: access denied",
    ]


def test_the_doctor_names_the_producer_or_says_what_is_missing(tmp_path, monkeypatch):
    rig = make(tmp_path, sensor={"port": "only"})
    rig.bench = None
    monkeypatch.setattr(Rig, "open", lambda rig: (_ for _ in ()).throw(Gs2ciError("stop here")))
    monkeypatch.setenv(gentl.PATHS, str(tmp_path))
    found = {one.what: one for one in examine(rig)}["GenTL producer"]
    assert found.verdict == "bad"
    assert "GENICAM_GENTL64_PATH" in found.remedy
    (tmp_path / "maker.cti").touch()
    found = {one.what: one for one in examine(rig)}["GenTL producer"]
    assert (found.verdict, found.detail) == ("ok", str(tmp_path / "maker.cti"))


def test_cameras_of_a_producer_are_among_what_is_found(monkeypatch):
    camera = CameraIdentity("Maker", "Model", "123", "U3V")
    monkeypatch.setattr(gentl.GenTlPort, "list_cameras", lambda port, producer: [camera])
    found = discovery.find_devices(V4l2Twin(World(), CameraModel()))
    assert ("sensor", "123", "Maker Model (GenICam, U3V)") in found
