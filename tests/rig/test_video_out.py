"""A bench whose modulator is a second display: examined, planned, found."""

from gs2ci.rig import discovery
from gs2ci.rig.config import RigTable
from gs2ci.rig.doctor import examine
from gs2ci.rig.opening import Rig
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.links import sdl_screen
from gs2ci_drivers.ports import ScreenOutput
from gs2ci_sims.wires.v4l2 import V4l2Twin
from gs2ci_sims.wires.v4l2_camera import CameraModel
from gs2ci_sims.world import Darkness, World

TABLES = {
    "modulator": {"kind": "video", "trigger_patch": [0, 0, 40, 40]},
    "sensor": {"kind": "v4l2", "format": "Y12"},
    "world": {"height": 48, "width": 64},
}


def test_the_doctor_finds_its_trigger_by_the_patch_and_nothing_wrong(tmp_path):
    table = RigTable.model_validate(TABLES)
    found = {one.what: one for one in examine(Rig(table, "", tmp_path, build_bench(table, Darkness())))}
    assert [one for one in found.values() if one.verdict == "bad"] == []
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail
    assert found["modulator protocol"].verdict == "note"  # experimental


def test_video_outputs_are_among_what_is_found(monkeypatch):
    monkeypatch.setattr(sdl_screen.SdlScreen, "list_outputs", lambda port: [ScreenOutput("HDMI-1", 1080, 1920, 60.0)])
    found = discovery.find_devices(V4l2Twin(World(), CameraModel()))
    assert ("screen", "HDMI-1", "video output, 1920 x 1080 at 60 Hz") in found
