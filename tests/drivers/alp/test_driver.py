"""The ALP driver on its twin, and the layout of pictures and pulses."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci_drivers.alp.codes import gate
from gs2ci_drivers.alp.driver import AlpModulator
from gs2ci_drivers.alp.layout import lay_out
from gs2ci_drivers.alp.options import AlpOptions
from gs2ci_drivers.failures import AccessError, DeviceFaultError, OutOfRangeError, RefusedError, SequenceError
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.testing.modulator_bench import ModulatorBench
from gs2ci_sims.wires.alp import AlpTwin
from gs2ci_sims.world import World

MASKS = np.random.default_rng(5).integers(0, 2, (4, 32, 48), dtype=np.uint8)
SEQUENCE = PatternSequence(MASKS, 1, 2e-3)


def bench(settings=None, **twin):
    world = World()
    device = AlpTwin(world, height=32, width=48, **twin)
    made = ModulatorBench(AlpModulator, "dmd0", device, world, settings)
    made.modulator.connect()
    return made


@pytest.mark.parametrize(
    ("changes", "order", "repeats", "pulses"),
    [
        ({}, (0, 1, 2, 3, -1), 1, (True, False, False, False, False)),
        ({"trigger": TriggerOut.PER_MASK}, (0, 1, 2, 3, -1), 1, (True, True, True, True, False)),
        ({"trigger": TriggerOut.PER_MASK, "dark_s": 1e-3}, (0, 1, 2, 3), 1, (True,)),
        ({"trigger": TriggerOut.NONE, "repeats": 2}, (0, 1, 2, 3) * 2 + (-1,), 1, (False,)),
        ({"repeats": 3, "pause_s": 4e-3}, (0, 1, 2, 3, -1, -1), 3, (True, False, False, False, False, False)),
        ({"repeats": 3, "dark_s": 1e-3, "pause_s": 4e-3}, (0, 1, 2, 3, -1), 3, (True, False, False, False, False)),
        ({"repeats": 0}, (0, 1, 2, 3), 0, (True, False, False, False)),
    ],
)
def test_masks_become_pictures_that_end_dark(changes, order, repeats, pulses):
    found = lay_out("dmd0", replace(SEQUENCE, **changes))
    assert (found.order, found.repeats, found.pulses) == (order, repeats, pulses)
    assert found.uninterrupted == ("dark_s" not in changes)


def test_a_pause_that_is_not_made_of_pictures_is_refused_with_the_next_one():
    with pytest.raises(OutOfRangeError, match="whole pictures of 2000 us: 4000 us is the next"):
        lay_out("dmd0", replace(SEQUENCE, repeats=2, pause_s=3e-3))


def test_pulses_that_do_not_repeat_soon_are_refused():
    masks = np.zeros((20, 32, 48), np.uint8)
    with pytest.raises(OutOfRangeError, match=r"repeat after 21 pictures.*at most 16"):
        lay_out("dmd0", replace(SEQUENCE, masks=masks))
    assert len(lay_out("dmd0", replace(SEQUENCE, masks=masks, trigger=TriggerOut.PER_MASK, dark_s=1e-3)).order) == 20


@pytest.mark.parametrize(("pause_s", "dark_s", "given_s"), [(1e-3, 0.0, 2e-3), (5e-3, 1e-3, 7e-3), (1e-6, 1e-3, 1e-3)])
def test_the_plan_asks_for_a_pause_that_the_device_can_keep(pause_s, dark_s, given_s):
    info = bench().modulator.info
    found_s = info.pause_at_least_s(pause_s, 2e-3, dark_s)
    assert found_s == pytest.approx(given_s)
    lay_out("dmd0", replace(SEQUENCE, repeats=2, dark_s=dark_s, pause_s=found_s))


def test_the_gates_structure_has_18_bytes_and_no_padding():
    assert gate([True, False, True], active_high=False) == bytes([3, 0, 1, 0, 1]) + bytes(13)


def test_a_mask_of_ones_is_not_dark():
    """The device takes the highest bit of a byte: a driver that sent 1 would show nothing."""
    one = bench()
    shown = one.run(SEQUENCE)
    assert [mask.levels.sum() for mask in shown] == [int(mask.sum()) for mask in MASKS]


def test_an_inverted_device_shows_the_opposite_and_is_dark_in_between():
    one = bench(AlpOptions(kind="alp", invert=True))
    shown = one.run(SEQUENCE)
    assert [mask.levels.sum() for mask in shown] == [mask.size - int(mask.sum()) for mask in MASKS]
    begin_s = one.world.clock.now_s()
    one.world.clock.sleep_s(0.1)
    assert one.world.masks_between(begin_s, begin_s + 0.1) == ()


def test_an_endless_run_that_is_halted_leaves_no_mask_behind():
    one = bench()
    one.modulator.upload(replace(SEQUENCE, repeats=0))
    one.modulator.arm()
    one.modulator.start()
    one.world.clock.sleep_s(0.0131)
    pulses = len(one.world.bus.rising("alp0.out"))
    one.modulator.disarm()
    one.world.clock.sleep_s(0.01)
    assert one.world.masks_between(one.world.clock.now_s() - 1e-3, one.world.clock.now_s()) == ()
    assert len(one.world.bus.rising("alp0.out")) == pulses


def test_pulses_may_be_low():
    one = bench(AlpOptions(kind="alp", trigger_active="low"))
    one.modulator.upload(SEQUENCE)
    one.modulator.arm()
    assert one.world.bus.level("alp0.out")
    one.modulator.start()
    one.modulator.wait_done(1.0)
    falls = [edge for edge in one.world.bus.edges if not edge.level]
    assert len(falls) == 1
    verdict = one.modulator.other_polarity()
    assert verdict.settings == {"trigger_active": "high"}
    assert 'trigger_active = "high"' in verdict.remedy


def test_a_run_that_ends_early_is_an_error():
    one = bench()
    one.twin.faults.inject("alp.stops_early", skip=2)
    with pytest.raises(SequenceError, match="before its last mask"):
        one.run(replace(SEQUENCE, exposure_s=20e-3))


def test_a_device_of_another_program_is_not_taken():
    world = World()
    twin = AlpTwin(world)
    twin.faults.inject("alp.held")
    made = ModulatorBench(AlpModulator, "dmd0", twin, world)
    with pytest.raises(AccessError, match=r"another program has the device.*close that program"):
        made.modulator.connect()


def test_a_board_without_mirrors_is_not_used_as_one_with_1080_rows():
    with pytest.raises(DeviceFaultError, match="no mirror device is connected"):
        bench(kind=255)


def test_where_the_library_tells_no_size_the_type_of_the_mirrors_does():
    world = World()
    twin = AlpTwin(world, kind=3, height=1080, width=1920, tells_size=False)
    info = ModulatorBench(AlpModulator, "dmd0", twin, world).modulator.connect()
    assert (info.height, info.width) == (1080, 1920)
    with pytest.raises(RefusedError, match="1005"):
        bench(kind=12, tells_size=False)


def test_mirrors_that_float_are_a_fault():
    one = bench()
    one.modulator.upload(SEQUENCE)
    one.twin.faults.inject("alp.floats")
    assert one.modulator.status().state is ModulatorState.FAULT
    with pytest.raises(DeviceFaultError, match="POWER_FLOAT"):
        one.modulator.arm()


def test_memory_that_is_full_is_told_and_a_smaller_upload_works():
    one = bench(memory=12)
    assert one.modulator.info.capacity == {1: 10}
    one.twin.faults.inject("alp.refuses", about="AlpSeqAlloc", skip=1, value=1007)
    with pytest.raises(RefusedError, match=r"1007 \(the device's memory is full\)"):
        one.modulator.upload(SEQUENCE)
    assert len(one.run(SEQUENCE)) == 4


def test_limits_that_cannot_be_read_leave_no_sequence_behind():
    world = World()
    twin = AlpTwin(world)
    twin.faults.inject("alp.refuses", about="AlpSeqInquire")
    made = ModulatorBench(AlpModulator, "dmd0", twin, world)
    with pytest.raises(RefusedError, match="1005"):
        made.modulator.connect()
    assert twin._sequences == {}


def test_temperatures_are_told_where_there_are_sensors():
    assert bench().modulator.temperatures_c()["board"] == pytest.approx(36.5)
    assert bench(temperature_c=None).modulator.temperatures_c() == {}


def test_a_lost_pulse_is_missing_on_the_line():
    one = bench()
    one.twin.faults.inject("alp.pulse_lost")
    one.run(replace(SEQUENCE, trigger=TriggerOut.PER_MASK))
    assert len(one.world.bus.rising("alp0.out")) == 3


@pytest.mark.parametrize("port", ["usb:", "usb:x", "/dev/usb"])
def test_a_port_that_is_none_is_refused(port):
    with pytest.raises(ValidationError, match="port"):
        AlpOptions(kind="alp", port=port)


def test_where_the_library_is_follows_from_the_version(tmp_path):
    assert AlpOptions(kind="alp", port="usb:12").serial == 12
    assert str(AlpOptions(kind="alp").library_file) == "/usr/lib/x86_64-linux-gnu/libalp43.so"
    assert AlpOptions(kind="alp", version="5.1", library=str(tmp_path)).library_file == tmp_path / "libalp51.so"
