"""What no fault of a twin brings about in a capture; the faults are in tests/system/test_faults.py."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci_drivers.acquisition import capture, plan_capture
from gs2ci_drivers.failures import ExtraFrameError, NoAnswerError, TriggerTimeoutError
from gs2ci_drivers.plan import CaptureSettings, Mode
from tests.bench_truth import opened
from tests.calibration.random_benches import random_table

MASK_S = 0.02


@pytest.fixture
def bench():
    with opened(random_table(3)) as (bench, _):
        yield bench


def settings_for(bench, **changes):
    masks = np.ones((3, *bench.modulator_size), np.uint8)
    return CaptureSettings(masks, mask_s=MASK_S, mode=Mode.PER_MASK, margin_s=MASK_S / 2, **changes)


def test_a_modulator_that_goes_silent_while_a_sound_capture_is_planned_is_told(bench, monkeypatch):
    def silent(sequence):
        raise NoAnswerError("modulator", "ask", 1.0)

    monkeypatch.setattr(bench.devices.modulator, "upload_eta_s", silent)
    with pytest.raises(NoAnswerError, match="modulator: ask"):
        plan_capture(bench.devices, settings_for(bench), bench.config)
    deep = settings_for(bench, bit_depth=3)
    assert plan_capture(bench.devices, deep, bench.config).broken  # which the plan says better


@pytest.mark.parametrize(
    ("off_s", "error", "says"),
    [
        (MASK_S, TriggerTimeoutError, "trigger 1: no frame 1 after"),
        (-MASK_S / 2, ExtraFrameError, "trigger 1: frame 1 came 0.01 s before its trigger could"),
    ],
)
def test_a_frame_that_was_taken_at_another_time_than_its_trigger_is_refused(bench, monkeypatch, off_s, error, says):
    sensor = bench.devices.sensor
    plan = plan_capture(bench.devices, settings_for(bench), bench.config)
    read, taken = sensor.read, []

    def shifted(timeout_s, **which):
        frame = read(timeout_s, **which)
        moved = round(off_s * 1e9) if which["trigger_index"] == 1 else 0
        return replace(frame, t_kernel_ns=frame.t_kernel_ns + moved)

    monkeypatch.setattr(sensor, "read", shifted)
    with pytest.raises(error, match=says):
        capture(bench.devices, plan, taken.append)
    assert not taken
    assert not sensor.status().streaming


def test_a_capture_ends_early_when_what_was_taken_is_enough_with_all_devices_at_rest(bench):
    plan = plan_capture(bench.devices, settings_for(bench, shots=3), bench.config)
    taken = []
    assert capture(bench.devices, plan, taken.append, enough=lambda: len(taken) == 2) == 2
    assert [one.index for one in taken] == [0, 1]
    assert not bench.devices.sensor.status().streaming
