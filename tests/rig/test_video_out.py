"""A bench whose modulator is a second display: examined, planned, found."""

from functools import partial

import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.rig import discovery
from gs2ci.rig.config import RigTable
from gs2ci.rig.doctor import examine
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.failures import PlanRefusedError
from gs2ci_drivers.links import sdl_screen
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.ports import ScreenOutput
from gs2ci_sims.wires import screen
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
    monkeypatch.setattr(screen, "ScreenTwin", partial(screen.ScreenTwin, refresh_hz=refresh_hz))
    table = RigTable.model_validate(TABLES)
    found = {one.what: one for one in examine(Rig(table, "", tmp_path, build_bench(table, Darkness())))}
    assert [one for one in found.values() if one.verdict == "bad"] == []
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail
    assert found["modulator protocol"].verdict == "note"  # experimental


@pytest.mark.parametrize(
    ("kind", "levels"),
    [
        ("video", {"dark_level": 40, "bright_level": 200}),
        ("video", {"dark_level": 255, "bright_level": 0}),
        ("video", {"grey_table": [20, 160, 240]}),
        ("video", {"grey_table": [250, 90, 80, 10]}),
        ("santec", {"dark_level": 100, "bright_level": 900}),
        ("santec", {"dark_level": 1023, "bright_level": 0}),
    ],
)
def test_a_simulated_panel_passes_what_the_masks_say_whatever_its_levels(tmp_path, kind, levels):
    world = TABLES["world"] | {"panel_response_s": 0.0}
    table = RigTable.model_validate(TABLES | {"modulator": {"kind": kind, **levels}, "world": world})
    bench = build_bench(table, Darkness())
    devices = Rig(table, "", tmp_path, bench).open()
    try:
        modulator, info = devices.modulator, devices.modulator.connect()
        size = (info.height, info.width)
        shares = (0.0, 0.25, 0.5, 1.0)
        masks = np.stack([np.full(size, round(255 * share), np.uint8) for share in shares])
        modulator.upload(PatternSequence(masks, 8, exposure_s=0.2, pause_s=0.2, trigger=TriggerOut.NONE))
        modulator.arm()
        begin_s = bench.world.clock.now_s()
        modulator.start()
        modulator.wait_done(60.0)
        bench.world.clock.sleep_s(0.1)
        shown = bench.world.masks_between(begin_s, bench.world.clock.now_s())
    finally:
        devices.close()
    passed = [float(one.levels.mean()) / one.top for one in shown]
    # Levels are whole numbers. Whether a dark panel counts as one that shows a mask of zeros is the twin's affair.
    assert [share for share in passed if share] == pytest.approx(shares[1:], abs=5e-3)


def test_the_patch_of_a_simulated_panel_is_lit_at_its_bright_level(tmp_path):
    modulator = TABLES["modulator"] | {"dark_level": 0, "bright_level": 90}
    table = RigTable.model_validate(TABLES | {"modulator": modulator})
    found = {one.what: one for one in examine(Rig(table, "", tmp_path, build_bench(table, Darkness())))}
    assert "8 triggers gave 8 frames" in found["trigger loop"].detail


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
