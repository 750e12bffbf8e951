"""The three contracts on a rig file's devices, as far as they can be tested from outside.

These tests always run on a simulated rig of twins; with `pytest tests/contracts/test_on_rig.py --rig FILE` also on real
devices. The stage moves by 1 mm about its position, the modulator shows a few masks, the sensor takes frames. The
other suites of this folder also inspect the state of the twins.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gs2ci.rig.config import RigTable
from gs2ci.rig.opening import Rig, load_rig
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.acquisition import Devices, capture, plan_capture
from gs2ci_drivers.failures import NoAnswerError, OutOfRangeError, TriggerTimeoutError, WrongStateError
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.plan import CaptureSettings, Mode
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from gs2ci_sims.world import Darkness

MASK_S = 0.03


def _simulated(stage: str, modulator: str) -> Rig:
    table = RigTable.model_validate(
        {
            "modulator": {"kind": modulator} | ({"trigger_out_2_bit": "disables"} if modulator == "dlpc900" else {}),
            "sensor": {"kind": "v4l2", "format": "Y12"},
            "stage": {"kind": stage},
            "world": {"height": 48, "width": 64},
        }
    )
    return Rig(table, "", Path(), build_bench(table, Darkness()))


RIGS = {
    "simulated DLPC900 + Zaber": lambda _: _simulated("zaber", "dlpc900"),
    "simulated SCPI + GRBL": lambda _: _simulated("grbl", "scpi"),
    "simulated Santec + Zaber": lambda _: _simulated("zaber", "santec"),
    "real": load_rig,
}


@pytest.fixture(params=RIGS)
def rig(request: pytest.FixtureRequest) -> Rig:
    path = request.config.getoption("--rig")
    if request.param == "real" and path is None:
        pytest.skip("no real devices: give their rig file with --rig FILE")
    return RIGS[request.param](path)


@pytest.fixture
def devices(rig: Rig) -> Iterator[Devices]:
    devices = rig.open()
    yield devices
    devices.close()


@pytest.fixture
def sequence(devices: Devices) -> PatternSequence:
    info = devices.modulator.connect()
    bits = min(info.min_exposure_s)
    masks = np.zeros((3, info.height, info.width), np.uint8)
    masks[::2] = 1
    return PatternSequence(masks, bits, max(MASK_S, 2 * info.min_exposure_s[bits]), trigger=TriggerOut.PER_MASK)


def _config(rig: Rig, trigger: TriggerMode) -> SensorConfig:
    table = rig.table.sensor
    return SensorConfig(table.height, table.width, table.format.strip(), MASK_S / 2, trigger, buffers=table.buffers)


def test_connecting_twice_gives_the_same_and_moves_nothing(devices: Devices) -> None:
    for device in (devices.modulator, devices.sensor):
        assert device.connect() == device.connect()
    if devices.stage is not None:
        assert devices.stage.connect() == devices.stage.connect()
        before = devices.stage.positions_mm()
        assert not devices.stage.status().moving
        assert devices.stage.positions_mm() == before


def test_a_closed_device_refuses_and_may_be_closed_again(devices: Devices) -> None:
    devices.close()
    devices.close()
    for device in (devices.modulator, devices.sensor, devices.stage):
        if device is not None:
            with pytest.raises(WrongStateError, match="closed"):
                device.connect()


def test_a_sequence_runs_to_its_end_and_can_run_again(devices: Devices, sequence: PatternSequence) -> None:
    modulator = devices.modulator
    eta_s = modulator.upload_eta_s(sequence)
    report = modulator.upload(sequence)
    assert eta_s > 0
    assert report.sequence == modulator.loaded
    for _ in range(2):
        modulator.arm()
        begin_s = devices.clock.now_s()
        modulator.start()
        modulator.wait_done(sequence.duration_s + 2.0)
        assert devices.clock.now_s() - begin_s >= 0.9 * sequence.duration_s
    modulator.disarm()
    assert modulator.status().state is not ModulatorState.RUNNING


def test_an_endless_sequence_is_waited_for_no_longer_than_told_and_can_be_stopped(
    devices: Devices, sequence: PatternSequence
) -> None:
    modulator = devices.modulator
    modulator.upload(replace(sequence, repeats=0, pause_s=sequence.exposure_s))
    modulator.arm()
    modulator.start()
    with pytest.raises(NoAnswerError):
        modulator.wait_done(0.5)
    modulator.disarm()
    modulator.disarm()
    assert modulator.status().state is not ModulatorState.RUNNING


def test_calls_in_the_wrong_order_are_refused(devices: Devices) -> None:
    devices.modulator.connect()
    devices.sensor.connect()
    with pytest.raises(WrongStateError):
        devices.modulator.arm()
    with pytest.raises(WrongStateError):
        devices.modulator.start()
    with pytest.raises(WrongStateError):
        devices.sensor.start()
    with pytest.raises(WrongStateError):
        devices.sensor.read(0.1)
    devices.modulator.disarm()
    devices.sensor.stop()


def test_a_trigger_that_never_comes_is_given_up_at_its_deadline(rig: Rig, devices: Devices) -> None:
    devices.modulator.connect()
    devices.modulator.disarm()
    devices.sensor.connect()
    devices.sensor.configure(_config(rig, TriggerMode.EDGE))
    devices.sensor.start()
    begin_s = devices.clock.now_s()
    with pytest.raises(TriggerTimeoutError, match="trigger 4") as caught:
        devices.sensor.read(0.5, trigger_index=4)
    assert caught.value.frame_index == 0
    assert 0.4 <= devices.clock.now_s() - begin_s < 2.0
    devices.sensor.stop()
    devices.sensor.stop()


def test_every_mask_triggers_one_frame(rig: Rig, devices: Devices, sequence: PatternSequence) -> None:
    settings = CaptureSettings(
        sequence.masks,
        sequence.bit_depth,
        sequence.exposure_s,
        mode=Mode.PER_MASK,
        shots=2,
        margin_s=sequence.exposure_s / 2,
    )
    taken = []
    plan = plan_capture(devices, settings, _config(rig, TriggerMode.EDGE))
    assert capture(devices, plan, taken.append) == 2
    assert [shot.trigger_index for shot in taken] == [0, 3]
    for shot in taken:
        assert len(shot.frames) == 3
        stamps = np.diff([frame.t_kernel_ns for frame in shot.frames]) * 1e-9
        assert stamps == pytest.approx(plan.frame_period_s, rel=0.05)


def test_a_small_move_arrives_on_the_axis_own_steps_and_back(devices: Devices) -> None:
    stage = devices.stage
    if stage is None:
        pytest.skip("the rig has no stage")
    info = stage.connect()
    name, axis = next(iter(info.axes.items()))
    here = stage.positions_mm()[name]
    there = here + (1.0 if here + 1.0 <= axis.max_mm else -1.0)
    reached = stage.move_to({name: there})
    assert reached[name] == pytest.approx(there, abs=2 * axis.step_mm)
    assert stage.move_to({name: here})[name] == pytest.approx(here, abs=2 * axis.step_mm)
    stage.stop()
    stage.stop()


def test_a_target_beyond_the_travel_is_refused_and_nothing_moves(devices: Devices) -> None:
    stage = devices.stage
    if stage is None:
        pytest.skip("the rig has no stage")
    name, axis = next(iter(stage.connect().axes.items()))
    before = stage.positions_mm()
    with pytest.raises(OutOfRangeError, match="limits"):
        stage.move_to({name: axis.max_mm + 1.0})
    assert stage.positions_mm() == before
