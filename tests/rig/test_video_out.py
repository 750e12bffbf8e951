"""A bench whose modulator is a second display: examined, planned, found."""

from functools import partial

import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.rig import discovery, simulated
from gs2ci.rig.config import RigTable
from gs2ci.rig.doctor import examine
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.failures import PlanRefusedError
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


@pytest.mark.parametrize("refresh_hz", [60.0, 59.94, 45.0])
def test_the_doctor_finds_its_trigger_by_the_patch_and_nothing_wrong(tmp_path, monkeypatch, refresh_hz):
    monkeypatch.setattr(simulated, "ScreenTwin", partial(simulated.ScreenTwin, refresh_hz=refresh_hz))
    table = RigTable.model_validate(TABLES)
    found = {one.what: one for one in examine(Rig(table, "", tmp_path, build_bench(table, Darkness())))}
    assert [one for one in found.values() if one.verdict == "bad"] == []
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail
    assert found["modulator protocol"].verdict == "note"  # experimental


@pytest.fixture
def capturing(tmp_path):
    """Return a function that captures with some settings, and returns the plan and the share of each mask's time that
    was exposed."""

    def capture(**asked):
        table = RigTable.model_validate(TABLES | {"capture": {"masks": 4, **asked}})
        rig = Rig(table, "", tmp_path, build_bench(table, Darkness()))
        devices = rig.open()
        try:
            prepared = prepare(rig, devices)
            record(rig, devices, prepared, tmp_path / "shot.h5", replace=True, progress=Silent())
            assert devices.modulator.loaded.exposure_s == prepared.plan.sequence.exposure_s
        finally:
            devices.close()
        mask_s = prepared.plan.sequence.exposure_s
        return prepared.plan, [(one.end_s - one.start_s) / mask_s for one in rig.bench.world.exposures[-1].masks]

    return capture


@pytest.mark.parametrize("asked", [{"mask_s": 0.032}, {"mask_s": 0.0345, "margin_s": 0.01}, {"mask_s": 1 / 60}])
def test_weights_are_those_of_the_times_that_the_display_shows(capturing, asked):
    plan, seen = capturing(**asked)
    assert np.asarray(seen) == pytest.approx(plan.weights, abs=2e-3)
    assert all(plan.weights[:3] > 0.99)


@pytest.mark.parametrize("mask_s", [0.01, 0.02, 0.025, 0.03])
def test_a_time_between_two_refreshes_is_refused_with_those_on_both_sides(capturing, mask_s):
    with pytest.raises(PlanRefusedError, match=r"set `mask_s` to 0\.01666667( or 0\.03333333)?;"):
        capturing(mask_s=mask_s)


def test_video_outputs_are_among_what_is_found(monkeypatch):
    monkeypatch.setattr(sdl_screen.SdlScreen, "list_outputs", lambda port: [ScreenOutput("HDMI-1", 1080, 1920, 60.0)])
    found = discovery.find_devices(V4l2Twin(World(), CameraModel()))
    assert ("screen", "HDMI-1", "video output, 1920 x 1080 at 60 Hz") in found
