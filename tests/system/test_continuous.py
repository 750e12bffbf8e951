"""Continuous captures on the small rig: their rate, the written rows, the report of lost frames, bounded memory."""

import json
from itertools import pairwise

import h5py
import numpy as np
import pytest

from gs2ci.core.storage import count_shots, read_shot
from gs2ci.rig.recording import prepare, record
from gs2ci_drivers import acquisition, frame_timing
from gs2ci_drivers.failures import FrameCorruptError, PlanRefusedError, TriggerTimeoutError

SHOTS = 40
CAPTURE = {"continuous": True, "masks": 2, "mask_s": 0.02, "axis": "", "shots": SHOTS}


def plan_of(small):
    devices = small.rig.open()
    try:
        return prepare(small.rig, devices).plan
    finally:
        devices.close()


def events(path):
    with h5py.File(path) as file:
        return [json.loads(text) for text in file["events"][:]]


@pytest.mark.parametrize("kind", ["v4l2", "genicam"])
def test_every_exposure_is_what_the_masks_make_and_they_follow_each_other_without_a_pause(make_small, kind):
    sensor = {"kind": kind, "format": "Y12" if kind == "v4l2" else "Mono12", "height": 48, "width": 64}
    small = make_small(dlp5500=True, capture=CAPTURE, sensor=sensor | {"black_level_dn": 16.0})
    plan = plan_of(small)
    small.capture()
    assert count_shots(small.out) == SHOTS
    exposures = small.bench.world.exposures
    apart = [after.start_s - before.start_s for before, after in pairwise(exposures)]
    assert apart == pytest.approx([plan.sequence.period_s] * (SHOTS - 1), abs=1e-5)
    # As long as exposure and readout take, and the step of the modulator's clock.
    devices_s = plan.exposure_s + 48 * 10e-6 + plan.settings.jitter_s
    assert plan.sequence.period_s == pytest.approx(devices_s, abs=5e-4)
    with h5py.File(small.out) as file:
        readings = file["meas"][:].astype(float)
    for row in (0, 1, SHOTS - 1):
        expected = small.expected_dn(row, read_shot(small.out, row).masks)
        np.testing.assert_allclose(readings[row], expected, rtol=0, atol=0.51)


def test_the_plan_says_how_fast_and_what_overlaps(make_small):
    figures = {figure.what: figure for figure in plan_of(make_small(dlp5500=True, capture=CAPTURE)).figures}
    assert "exposures a second" in figures["continuous"].value
    assert "during the next exposures; 16 may wait" in figures["writing"].value


@pytest.mark.parametrize("change", [{"axis": "x"}, {"mode": "per-mask"}])
def test_a_moving_camera_and_single_masks_are_refused(make_small, change):
    plan = plan_of(make_small(dlp5500=True, capture=CAPTURE | change))
    with pytest.raises(PlanRefusedError, match="continuous = false"):
        plan.require_sound()


def test_frames_that_are_lost_or_spoilt_are_named_and_the_rest_is_whole(make_small):
    small = make_small(dlp5500=True, capture=CAPTURE)
    faults = small.bench.faults["sensor"]
    faults.inject("v4l2.frame_dropped", skip=5, times=3)
    faults.inject("v4l2.frame_corrupt", skip=20)
    small.capture()
    assert count_shots(small.out) == SHOTS - 4
    said = [event["message"] for event in events(small.out) if event["kind"] == "incident"]
    assert [text.split(";")[0] for text in said] == [
        "sensor, trigger 5: 3 frame(s) lost from frame 5 on",
        said[1].split(";")[0],
    ]
    assert "is corrupt" in said[1]
    with h5py.File(small.out) as file:
        triggers = file["frames/trigger_index"][: SHOTS - 4]
        stamps = file["frames/t_kernel_ns"][: SHOTS - 4]
    missing = sorted(set(range(SHOTS)) - set(triggers.tolist()))
    assert missing[:3] == [5, 6, 7]
    assert len(missing) == 4
    period_ns = plan_of(small).sequence.period_s * 1e9
    assert (stamps - stamps[0]) / period_ns == pytest.approx(triggers - triggers[0], abs=0.01)
    for row, trigger in ((4, 4), (5, 8), (SHOTS - 5, SHOTS - 1)):
        assert triggers[row] == trigger


def test_the_first_and_the_last_frame_may_be_lost_too(make_small):
    small = make_small(dlp5500=True, capture=CAPTURE)
    small.bench.faults["sensor"].inject("v4l2.frame_dropped", times=2)
    small.bench.faults["sensor"].inject("v4l2.frame_corrupt", skip=SHOTS - 3)
    small.capture()
    with h5py.File(small.out) as file:
        triggers = file["frames/trigger_index"][: SHOTS - 3].tolist()
    assert triggers == list(range(2, SHOTS - 1))
    said = [event["message"] for event in events(small.out) if event["kind"] == "incident"]
    assert [text.split(":")[0] for text in said] == ["sensor, trigger 0", f"sensor, trigger {SHOTS - 1}"]


@pytest.mark.parametrize("ended", ["whole", "by a missing trigger", "by hand"])
def test_what_came_after_the_last_row_is_told_there_and_not_in_the_next_file(make_small, ended):
    shots = 6
    small = make_small(dlp5500=True, capture=CAPTURE | {"shots": shots})
    devices = small.rig.open()
    log, written = small.out.with_name("shot.h5.session.jsonl"), small.out
    try:
        prepared = prepare(small.rig, devices)
        faults = small.bench.faults["sensor"]
        faults.inject("v4l2.frame_corrupt", skip=shots - 2, times=1 + (ended == "whole"))
        if ended == "whole":
            record(small.rig, devices, prepared, small.out, replace=True, progress=small.said)
        else:
            written = small.out.with_name("shot.h5.partial")
            read, error = devices.sensor.read, TriggerTimeoutError("sensor", 5, 1.0)
            if ended == "by hand":
                error = KeyboardInterrupt()

            def interrupted(*arguments, **named):
                if named["trigger_index"] == shots - 1:
                    raise error
                return read(*arguments, **named)

            devices.sensor.read = interrupted
            with pytest.raises(type(error)):
                record(small.rig, devices, prepared, small.out, replace=True, progress=small.said)
        assert devices.incidents() == []
    finally:
        devices.close()
    said = [event["message"] for event in events(written) if event["kind"] == "incident"]
    assert said[0].split(":")[0] == f"sensor, trigger {shots - 2}"
    assert all(text.endswith("skipped") for text in said)
    noted = [json.loads(line) for line in log.read_text().splitlines()]
    assert next(line for line in noted if line["event"] == "after the last shot")["incidents"] == said


def test_a_capture_without_one_whole_frame_ends_with_the_error_of_its_frames(make_small):
    small = make_small(dlp5500=True, capture=CAPTURE | {"shots": 3})
    small.bench.faults["sensor"].inject("v4l2.frame_corrupt", times=99)
    with pytest.raises(FrameCorruptError, match="trigger 2: frame 2 is corrupt"):
        small.capture()
    assert list(small.out.parent.glob("shot.h5*")) == [small.out.with_name("shot.h5.session.jsonl")]
    assert "trigger 0: frame 0 is corrupt" in small.out.with_name("shot.h5.session.jsonl").read_text()


def test_a_trigger_that_never_comes_ends_the_capture_and_the_rows_before_it_stay(make_small):
    small = make_small(dlp5500=True, capture=CAPTURE)
    small.bench.faults["sensor"].inject("v4l2.stalled", skip=10)
    with pytest.raises(TriggerTimeoutError):
        small.capture()
    with h5py.File(small.out.with_name("shot.h5.partial")) as file:
        assert file["meas_valid"][:].sum() == 10


def test_clocks_may_drift_apart_by_more_than_a_period(make_small, monkeypatch):
    """As two crystals do in an hour: held against the first frame, that would be a false alarm."""
    monkeypatch.setattr(frame_timing.FrameTiming, "check_end", lambda *_: None)  # it knows the true end
    small = make_small(dlp5500=True, capture=CAPTURE | {"shots": 20})
    devices = small.rig.open()
    try:
        prepared = prepare(small.rig, devices)
        read = devices.sensor._do_read
        drift_ns = 0

        def drifting(*arguments):
            nonlocal drift_ns
            frame = read(*arguments)
            drift_ns += 4_000_000  # a tenth of a period each
            return type(frame)(**(vars(frame) | {"t_kernel_ns": frame.t_kernel_ns + drift_ns}))

        devices.sensor._do_read = drifting
        taken = []
        assert acquisition.capture(devices, prepared.plan, taken.append) == 20
    finally:
        devices.close()


def test_a_simulated_world_forgets_what_a_long_capture_will_not_ask_for(make_small):
    small = make_small(dlp5500=True, capture=CAPTURE | {"mask_s": 1.0, "shots": 60})
    small.capture()
    world = small.bench.world
    assert count_shots(small.out) == 60
    assert len(world.exposures) < 25  # of 30 s
    assert world.exposures[-1].index == 59
    assert len(world.bus.edges) < 100
    assert len(world._shown) < 100
