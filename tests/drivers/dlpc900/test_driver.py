"""The DLPC900 driver against the firmware's twin: what is shown, what is pulsed, and every fault's typed error."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci.core.arrays import U8
from gs2ci_drivers.dlpc900.driver import Dlpc900
from gs2ci_drivers.dlpc900.options import Dlpc900Options
from gs2ci_drivers.dlpc900.options import TriggerEdges as Edges
from gs2ci_drivers.failures import (
    BadReplyError,
    DeviceFaultError,
    DisconnectedError,
    NoAnswerError,
    OutOfRangeError,
    RefusedError,
    SequenceError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.testing.modulator_bench import ModulatorBench
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.world import MaskInterval, World
from tests.drivers.faulty import FaultCase, strike

Bench = ModulatorBench[Dlpc900]


def make_bench(dmd: int = 5, settings: Dlpc900Options | None = None, *, counts_repeats: bool = False) -> Bench:
    world = World()
    twin = Dlpc900Twin(world, dmd=dmd, counts_repeats=counts_repeats)
    return Bench(Dlpc900, "dmd0", twin, world, settings or Dlpc900Options(reply_timeout_s=10.0))


@pytest.fixture
def bench() -> Bench:
    bench = make_bench()
    bench.modulator.connect()
    return bench


def masks_for(height: int, width: int, count: int, bits: int = 1, seed: int = 0) -> U8:
    """Random masks of coarse superpixels, so that uploads are short."""
    cells = np.random.default_rng(seed).integers(0, 1 << bits, (count, height // 8, width // 8), dtype=np.uint8)
    whole = np.kron(cells, np.ones((1, 8, 8), np.uint8))
    return np.pad(whole, ((0, 0), (0, height - whole.shape[1]), (0, width - whole.shape[2])))


MASKS = masks_for(768, 1024, 6)
SEQUENCE = PatternSequence(MASKS, 1, 500e-6, dark_s=0.0, pause_s=1e-3, repeats=2)


def assert_shown(shown: list[MaskInterval], masks: U8, repeats: int = 1) -> None:
    assert len(shown) == len(masks) * repeats
    for i, interval in enumerate(shown):
        np.testing.assert_array_equal(interval.levels, masks[i % len(masks)])


@pytest.mark.parametrize("dmd", range(1, 6))
def test_every_mirror_device_shows_the_masks_that_were_uploaded(dmd: int) -> None:
    bench = make_bench(dmd, Dlpc900Options())
    info = bench.modulator.connect()
    masks = masks_for(info.height, info.width, 3, seed=dmd)
    assert_shown(bench.run(PatternSequence(masks, 1, 500e-6)), masks)


@pytest.mark.parametrize("bits", [1, 3, 8])
def test_grey_masks_keep_their_levels_and_times(bench: Bench, bits: int) -> None:
    masks = masks_for(768, 1024, 5, bits)
    shown = bench.run(PatternSequence(masks, bits, 5e-3, dark_s=1e-3, pause_s=2e-3))
    assert_shown(shown, masks)
    assert {interval.top for interval in shown} == {(1 << bits) - 1}
    assert [interval.end_s - interval.start_s for interval in shown] == pytest.approx([5e-3] * 5)
    assert np.diff([interval.start_s for interval in shown]) == pytest.approx([6e-3] * 4)


def test_more_masks_than_bits_of_a_word_take_a_second_image(bench: Bench) -> None:
    masks = masks_for(768, 1024, 30)
    assert_shown(bench.run(PatternSequence(masks, 1, 500e-6)), masks)


def test_twelve_masks_with_depth_8_take_four_images_loaded_from_the_last(bench: Bench) -> None:
    masks = masks_for(768, 1024, 12, 8)
    assert_shown(bench.run(PatternSequence(masks, 8, 5e-3)), masks)


def test_masks_of_16_bit_arrays_are_taken_too(bench: Bench) -> None:
    assert_shown(bench.run(replace(SEQUENCE, masks=MASKS.astype(np.uint16), repeats=1)), MASKS)


@pytest.mark.parametrize(
    ("trigger", "pulses"),
    [(TriggerOut.PER_EXPOSURE, 2), (TriggerOut.PER_MASK, 12), (TriggerOut.NONE, 0), (TriggerOut.GATE, 0)],
)
def test_trigger_output_2_pulses_as_often_as_the_mode_says(bench: Bench, trigger: TriggerOut, pulses: int) -> None:
    shown = bench.run(replace(SEQUENCE, trigger=trigger))
    rises = bench.world.bus.rising("dmd0.out2")
    assert len(rises) == pulses
    begins = [interval.start_s for interval in shown]
    assert rises == pytest.approx([] if not pulses else begins[:: len(begins) // pulses])


def test_the_gate_is_one_level_from_the_first_mask_to_the_last(bench: Bench) -> None:
    shown = bench.run(replace(SEQUENCE, trigger=TriggerOut.GATE))
    edges = [edge for edge in bench.world.bus.edges if edge.line == "dmd0.out1"]
    assert [edge.level for edge in edges] == [True, False] * 2
    assert edges[1].when_s - edges[0].when_s == pytest.approx(6 * 500e-6)
    assert edges[0].when_s == pytest.approx(shown[0].start_s)


def test_trigger_edges_can_come_before_or_after_the_mask() -> None:
    settings = Dlpc900Options(trigger_out_2=Edges(rise_us=-20, fall_us=40))
    bench = make_bench(settings=settings)
    info = bench.modulator.connect()
    assert info.trigger_delay_s == info.delay_s(TriggerOut.PER_MASK) == pytest.approx(-20e-6)
    assert (info.delay_s(TriggerOut.GATE), info.gate_longer_s) == (0, 0)
    shown = bench.run(SEQUENCE)
    edges = [edge for edge in bench.world.bus.edges if edge.line == "dmd0.out2"]
    assert edges[0].when_s == pytest.approx(shown[0].start_s - 20e-6)
    assert edges[1].when_s == pytest.approx(shown[0].start_s + 40e-6)


def test_an_inverted_output_rests_high(bench: Bench) -> None:
    bench.settings = Dlpc900Options(trigger_out_2=Edges(inverted=True, fall_us=20))
    bench.reopen()
    bench.run(SEQUENCE)
    assert bench.world.bus.level("dmd0.out2")


@pytest.mark.parametrize("counts_repeats", [False, True])
def test_the_firmware_profile_settles_how_often_a_sequence_is_shown(counts_repeats: bool) -> None:
    right, wrong = ("rev-f", "rev-j") if counts_repeats else ("rev-j", "rev-f")
    bench = make_bench(settings=Dlpc900Options(firmware=right), counts_repeats=counts_repeats)
    assert len(bench.run(replace(SEQUENCE, repeats=3))) == 18
    bench = make_bench(settings=Dlpc900Options(firmware=wrong), counts_repeats=counts_repeats)
    bench.modulator.connect()
    begin_s = bench.world.clock.now_s()
    if counts_repeats:
        assert len(bench.run(replace(SEQUENCE, repeats=3))) == 6 * 18
    else:
        with pytest.raises(SequenceError, match=r"stopped by itself.*firmware"):
            bench.run(replace(SEQUENCE, repeats=3, exposure_s=50e-3))
        assert len(bench.world.masks_between(begin_s, bench.world.clock.now_s())) == 3


def test_counting_pulses_finds_the_wrong_firmware_profile() -> None:
    options = Dlpc900Options(firmware="rev-j", trigger_out_2_bit="disables")
    bench = make_bench(settings=options, counts_repeats=True)
    with pytest.raises(WrongStateError, match="no sequence"):
        bench.modulator.interpret_pulses(1)
    bench.run(replace(SEQUENCE, repeats=3))
    counted = len(bench.world.bus.rising("dmd0.out2"))
    assert counted == 18
    assert 'set firmware = "rev-f"' in bench.modulator.interpret_pulses(counted).remedy
    assert bench.modulator.interpret_pulses(3).agrees


def test_a_refusal_without_a_reason_says_so(bench: Bench) -> None:
    bench.twin.faults.inject("dlpc900.nack", about="display mode", value=5)
    bench.twin.firmware.note_error = lambda code: None  # type: ignore[method-assign]
    with pytest.raises(RefusedError, match="no reason given"):
        bench.modulator.upload(SEQUENCE)


def test_a_sequence_without_end_runs_until_disarmed(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    with pytest.raises(NoAnswerError, match=r"wait for the end.*within 0\.5"):
        bench.modulator.wait_done(0.5)
    assert bench.modulator.status().state is ModulatorState.RUNNING
    bench.modulator.disarm()
    assert bench.modulator.status().state is ModulatorState.LOADED
    now_s = bench.world.clock.now_s()
    bench.world.clock.sleep_s(1.0)
    assert not bench.world.masks_between(now_s, now_s + 1.0)


def test_connecting_only_reads(bench: Bench) -> None:
    firmware = bench.twin.firmware
    before = dict(firmware._settings), dict(firmware.table)
    bench.reopen()
    info = bench.modulator.connect()
    assert (dict(firmware._settings), dict(firmware.table)) == before
    assert (info.model, info.height, info.width) == ("TI DLPC900 + DLP5500", 768, 1024)
    assert info.firmware == "6.2.1 GS2CI-TWIN"


def test_connecting_leaves_a_running_sequence_alone(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    bench.reopen()
    bench.modulator.connect()
    assert bench.modulator.status().state is ModulatorState.RUNNING


def test_the_upload_takes_about_the_time_that_was_announced(bench: Bench) -> None:
    eta_s = bench.modulator.upload_eta_s(SEQUENCE)
    shares: list[float] = []
    report = bench.modulator.upload(SEQUENCE, shares.append)
    assert report.seconds == pytest.approx(eta_s, rel=0.1)
    assert report.payload_bytes == bench.modulator._images.total_bytes
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_new_times_for_the_same_masks_cost_no_second_upload(bench: Bench) -> None:
    bench.run(SEQUENCE)
    other = replace(SEQUENCE, exposure_s=700e-6, trigger=TriggerOut.PER_MASK, repeats=1)
    assert bench.modulator.upload_eta_s(other) < 0.2
    assert bench.modulator.upload(other).payload_bytes == 0
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    bench.modulator.wait_done(1.0)
    assert_shown(list(bench.world.masks_between(begin_s, bench.world.clock.now_s())), MASKS)


def test_beginning_with_another_mask_sends_no_image_again(bench: Bench) -> None:
    bench.run(SEQUENCE)
    began_s = bench.world.clock.now_s()
    bench.modulator.turn(3)
    taken_s = bench.world.clock.now_s() - began_s
    assert taken_s < 0.2
    assert taken_s == pytest.approx(bench.modulator.turn_eta_s(SEQUENCE), abs=0.1)
    assert bench.modulator.upload(SEQUENCE).payload_bytes == 0


def test_fewer_masks_from_the_same_images_are_uploaded_anew(bench: Bench) -> None:
    bench.run(SEQUENCE)
    assert_shown(bench.run(replace(SEQUENCE, masks=MASKS[:4], repeats=1)), MASKS[:4])


def test_standby_and_idling_are_left_for_an_upload(bench: Bench) -> None:
    bench.twin.faults.inject("dlpc900.standby")
    bench.twin.firmware._settings[0x0201] = b"\x01"
    assert_shown(bench.run(replace(SEQUENCE, repeats=1)), MASKS)


@pytest.fixture
def blocks() -> Bench:
    bench = make_bench(1, Dlpc900Options(blocks=(2, 3)))
    bench.modulator.connect()
    return bench


def test_fewer_mirror_blocks_allow_shorter_masks(blocks: Bench) -> None:
    masks = np.zeros((3, 1080, 1920), np.uint8)
    masks[:, 144:360] = masks_for(216, 1920, 3)
    assert blocks.modulator.info.min_exposure_s == {1: pytest.approx(45e-6)}
    assert_shown(blocks.run(PatternSequence(masks, 1, 45e-6)), masks)


@pytest.mark.parametrize(("dmd", "short_us"), [(1, (200, 600)), (5, (200, 600))])
def test_a_least_led_pulse_of_another_program_lengthens_the_shortest_masks(dmd: int, short_us: tuple[int, int]) -> None:
    bench = make_bench(dmd)
    bench.twin.firmware.write(0x1A43, (200 * 100).to_bytes(4, "little"))
    shortest_s = bench.modulator.connect().min_exposure_s
    assert [shortest_s[bits] for bits in (1, 2)] == pytest.approx([us * 1e-6 for us in short_us])
    assert shortest_s[8] == pytest.approx(255 * 200e-6)


def test_a_controller_that_does_not_know_its_least_exposures_is_believed_by_the_table() -> None:
    bench = make_bench(1)
    del bench.twin.firmware._reads[0x1A42]
    assert bench.modulator.connect().min_exposure_s[1] == pytest.approx(105e-6)
    assert bench.modulator.incidents == []


def test_a_range_of_blocks_that_an_earlier_session_left_does_not_dim_the_rest(blocks: Bench) -> None:
    masks = np.zeros((2, 1080, 1920), np.uint8)
    masks[:, 144:360] = 1
    blocks.run(PatternSequence(masks, 1, 200e-6))
    blocks.settings = Dlpc900Options()
    blocks.reopen()
    assert_shown(blocks.run(PatternSequence(masks_for(1080, 1920, 2), 1, 200e-6)), masks_for(1080, 1920, 2))


@pytest.mark.parametrize("numbers", [(0x1008,), (0x1009,), (0x1008, 0x1009)])
def test_flips_that_another_program_left_are_undone_and_the_images_loaded_again(
    bench: Bench, numbers: tuple[int, ...]
) -> None:
    bench.run(SEQUENCE)
    for number in numbers:
        bench.twin.firmware.write(number, b"\1")
    assert bench.modulator.upload(SEQUENCE).payload_bytes > 0
    assert len([text for text in bench.modulator.incidents if "flipped across the" in text]) == len(numbers)
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    bench.modulator.wait_done(1.0)
    assert_shown(list(bench.world.masks_between(begin_s, bench.world.clock.now_s()))[: len(MASKS)], MASKS)
    assert bench.modulator.upload(SEQUENCE).payload_bytes == 0


def test_the_twin_flips_what_is_loaded_after_a_flip() -> None:
    """Otherwise the test above would prove nothing."""
    bench = make_bench(settings=Dlpc900Options())
    bench.modulator.connect()
    bench.modulator._unflip = lambda: False
    bench.twin.firmware.write(0x1008, b"\1")
    assert_shown(bench.run(replace(SEQUENCE, repeats=1)), MASKS[:, ::-1])


def test_a_controller_that_knows_no_flips_is_used_as_it_is(bench: Bench) -> None:
    for number in (0x1008, 0x1009):
        del bench.twin.firmware._settings[number]
    assert_shown(bench.run(replace(SEQUENCE, repeats=1)), MASKS)


def test_blocks_beyond_the_device_are_refused_with_those_there_are() -> None:
    with pytest.raises(OutOfRangeError, match="blocks 0 to 14"):
        make_bench(1, Dlpc900Options(blocks=(13, 3))).modulator.connect()
    with pytest.raises(OutOfRangeError, match="no partial loading"):
        make_bench(5, Dlpc900Options(blocks=(0, 3))).modulator.connect()


@pytest.mark.parametrize("idle_after", [True, False])
def test_mirrors_are_left_idling_when_a_device_that_was_used_is_closed(idle_after: bool) -> None:
    bench = make_bench(settings=Dlpc900Options(idle_after=idle_after))
    bench.run(SEQUENCE)
    bench.modulator.disarm()
    bench.reopen()
    assert bench.twin.firmware._settings[0x0201] == (b"\x01" if idle_after else b"\x00")
    assert_shown(bench.run(replace(SEQUENCE, repeats=1)), MASKS)  # and an upload wakes them


def test_a_device_that_was_only_looked_at_is_closed_as_it_was(bench: Bench) -> None:
    bench.modulator.connect()
    bench.reopen()
    assert bench.twin.firmware._settings[0x0201] == b"\x00"


def test_light_outside_the_loaded_blocks_is_refused(blocks: Bench) -> None:
    with pytest.raises(OutOfRangeError, match="rows 144 to 359"):
        blocks.modulator.upload(PatternSequence(masks_for(1080, 1920, 2), 1, 45e-6))


@pytest.mark.parametrize("times", [{"dark_s": 1e-4}, {"pause_s": 0.0}])
def test_a_gate_that_would_fall_elsewhere_is_refused(bench: Bench, times: dict[str, float]) -> None:
    with pytest.raises(OutOfRangeError, match="TRIG_OUT_1"):
        bench.modulator.check(replace(SEQUENCE, trigger=TriggerOut.GATE, **times))


def test_an_unknown_mirror_device_or_firmware_profile_is_refused() -> None:
    bench = make_bench()
    bench.twin.firmware.dmd = 9
    with pytest.raises(UnsupportedError, match="type 9"):
        bench.modulator.connect()
    with pytest.raises(ValidationError, match="rev-j"):
        make_bench(settings=Dlpc900Options(firmware="rev-x"))


# -- faults ------------------------------------------------------------------------------------------------------


CASES = [
    FaultCase("dlpc900.reply_lost", "display mode", NoAnswerError, "select pattern-on-the-fly.*within 10 s"),
    FaultCase("dlpc900.reply_lost", "trigger out 2", NoAnswerError, "trigger output 2"),
    FaultCase("dlpc900.reply_lost", "table entry", NoAnswerError, "define mask 0"),
    FaultCase("dlpc900.reply_lost", "image start", NoAnswerError, "load image 0"),
    FaultCase("dlpc900.reply_lost", "error code", NoAnswerError, "error register"),
    FaultCase("dlpc900.reply_lost", "pattern control", NoAnswerError, "stop the sequence"),
    FaultCase("dlpc900.reply_lost", "pattern control", NoAnswerError, "start the sequence", skip=3),
    FaultCase("dlpc900.reply_lost", "main status", None),
    FaultCase("dlpc900.reply_lost", "main status", NoAnswerError, "read the status", times=2, within_s=22.0),
    FaultCase("dlpc900.reply_lost", "hardware status", None),
    FaultCase("dlpc900.reply_late", "display mode", None, value=4.0),
    FaultCase("dlpc900.reply_late", "display mode", NoAnswerError, "pattern-on-the-fly", value=11.0),
    FaultCase("dlpc900.reply_twice", "table entry", None, times=3),
    FaultCase("dlpc900.reply_garbled", "table config", BadReplyError, "number of masks.*65535"),
    FaultCase("dlpc900.reply_garbled", "main status", None),
    FaultCase("dlpc900.reply_short", "table config", BadReplyError, "no header"),
    FaultCase("dlpc900.reply_short", "main status", None, value=4.0),
    FaultCase("dlpc900.reply_other_sequence", "image start", NoAnswerError, "load image 0"),
    FaultCase("dlpc900.reply_other_sequence", "main status", None),
    FaultCase("dlpc900.babble", "table config", None),
    *(
        FaultCase(
            "dlpc900.nack",
            "table entry",
            RefusedError,
            f"define mask 0: refused with {code} .{meaning}",
            value=code,
        )
        for code, meaning in {
            1: "batch",
            2: "device failure",
            3: "invalid command",
            4: "controller and mirror",
            5: "command not allowed",
            6: "bad parameter",
            7: "item absent",
            8: "out of memory",
            9: "bad compression",
            10: "bit depth",
            11: "pattern image not in flash",
            12: "dark time",
            13: "signal delay",
            14: "exposure time",
            15: "pattern number",
            16: "invalid pattern",
            17: "image memory",
            255: "internal error",
        }.items()
    ),
    FaultCase("dlpc900.nack", "image data", RefusedError, "load image 0: refused with 9", value=9, skip=5),
    FaultCase("dlpc900.nack", "image start", RefusedError, "out of memory", value=8),
    FaultCase("dlpc900.nack", "pattern control", RefusedError, "start the sequence", value=16, skip=3),
    FaultCase("dlpc900.nack", "display mode", RefusedError, "pattern-on-the-fly", value=5),
    FaultCase("dlpc900.report_lost", "table config", NoAnswerError, "number of masks"),
    FaultCase("dlpc900.report_lost", "image start", NoAnswerError, "load image 0"),
    FaultCase("dlpc900.report_lost", "image data", RefusedError, "load image 0.*upload again", skip=11, within_s=25.0),
    FaultCase("dlpc900.report_lost", "image data", RefusedError, "load image 0.*upload again", skip=16, within_s=25.0),
    FaultCase("dlpc900.report_lost", "image data", RefusedError, "load image 0.*upload again", skip=23, within_s=25.0),
    FaultCase("dlpc900.write_stuck", "display mode", NoAnswerError, "write"),
    FaultCase("dlpc900.write_stuck", "image data", NoAnswerError, "load image 0", skip=10),
    FaultCase("dlpc900.write_stuck", "pattern control", NoAnswerError, "start the sequence", skip=3),
    *(
        FaultCase(fault, about, DisconnectedError, "device is gone", skip=skip)
        for fault in ("dlpc900.unplugged", "dlpc900.power_cycle")
        for about, skip in [
            ("power mode", 0),
            ("display mode", 0),
            ("trigger out 1", 0),
            ("table entry", 3),
            ("table config", 0),
            ("image start", 0),
            ("image data", 13),
            ("table config", 1),
            ("hardware status", 0),
            ("pattern control", 3),
            ("main status", 4),
        ]
    ),
    FaultCase("dlpc900.parked", "", None),
    FaultCase("dlpc900.parked", "", DeviceFaultError, "arm: .*mirrors are parked", skip=4),
    FaultCase("dlpc900.standby", "", None),
    FaultCase("dlpc900.stops_early", "", SequenceError, "stopped by itself", skip=3),
    FaultCase("dlpc900.sequencer_abort", "", SequenceError, "sequencer aborted", skip=3),
    FaultCase("dlpc900.forgets_images", "", RefusedError, "invalid pattern"),
]
SLOW = replace(SEQUENCE, exposure_s=60e-3, repeats=1)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_fault_is_ridden_out_or_a_typed_error_in_time_and_the_next_show_works(bench: Bench, case: FaultCase) -> None:
    strike(bench, case, SLOW, partial(assert_shown, masks=MASKS))


@pytest.mark.parametrize("case", [case for case in CASES if case.error is None and "status" in case.about], ids=str)
def test_what_was_ridden_out_is_noted(bench: Bench, case: FaultCase) -> None:
    bench.twin.faults.inject(case.fault, about=case.about, value=case.value)
    bench.run(SLOW)
    (incident,) = bench.modulator.incidents
    assert "asked again" in incident


@pytest.mark.parametrize("step", ["connect", "status", "arm", "start", "wait_done", "disarm"])
def test_unplugging_is_noticed_at_every_step(bench: Bench, step: str) -> None:
    bench.modulator.upload(SLOW)
    bench.modulator.arm()
    if step == "wait_done":
        bench.modulator.start()
    if step == "connect":
        bench.reopen()
    bench.twin.unplug()
    calls: dict[str, Callable[[], object]] = {
        "connect": bench.modulator.connect,
        "status": bench.modulator.status,
        "arm": bench.modulator.arm,
        "start": bench.modulator.start,
        "wait_done": lambda: bench.modulator.wait_done(5.0),
        "disarm": bench.modulator.disarm,
    }
    with pytest.raises(DisconnectedError, match=r"dmd0.*device is gone.*plug it in again"):
        calls[step]()
    bench.reopen()
    assert_shown(bench.run(SLOW), MASKS)


def test_a_stale_reply_of_a_killed_session_is_thrown_away(bench: Bench) -> None:
    bench.twin.faults.inject("dlpc900.stale")
    bench.reopen()
    assert bench.modulator.connect().height == 768


def test_an_error_of_an_earlier_session_is_not_ours(bench: Bench) -> None:
    bench.twin.firmware.note_error(9)
    bench.reopen()
    assert_shown(bench.run(replace(SEQUENCE, repeats=1)), MASKS)


def test_a_device_that_does_not_obey_a_stop_is_reported(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    bench.twin.faults.inject("dlpc900.ignores_stop")
    with pytest.raises(NoAnswerError, match=r"stop the sequence.*ignores its commands"):
        bench.modulator.disarm()
    bench.modulator.disarm()
    assert bench.modulator.status().state is ModulatorState.LOADED


def test_a_controller_that_reports_a_fault_is_not_armed(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.twin.firmware.sequencer.aborted = True
    with pytest.raises(DeviceFaultError, match=r"arm: .*sequencer"):
        bench.modulator.arm()
    with pytest.raises(WrongStateError, match="not armed"):
        bench.modulator.start()


@pytest.mark.parametrize("dmd", [2, 3, 4])
def test_of_two_controllers_a_silent_second_one_is_refused_by_name(dmd: int) -> None:
    """Otherwise whole rows would go to the first one, and half of the mirrors would stay dark."""
    bench = make_bench(dmd)
    bench.twin.faults.inject("dlpc900.secondary_silent")
    with pytest.raises(
        DeviceFaultError, match=r"secondary controller .* right half stays dark.*-primary and -secondary"
    ):
        bench.modulator.connect()


def test_a_second_controller_that_falls_silent_leaves_its_half_dark_and_is_not_armed() -> None:
    bench = make_bench(4)
    info = bench.modulator.connect()
    sequence = PatternSequence(masks_for(info.height, info.width, 2) | 1, 1, 500e-6)
    bench.modulator.upload(sequence)
    bench.twin.faults.inject("dlpc900.secondary_silent")
    with pytest.raises(DeviceFaultError, match="right half stays dark"):
        bench.modulator.arm()
    levels = bench.twin.firmware._plane(bench.twin.firmware.table[0])
    assert levels[:, : info.width // 2].all()
    assert not levels[:, info.width // 2 :].any()
    assert any("right half" in fault for fault in bench.modulator.status().faults)
    bench.twin.power_cycle()
    bench.twin.plug_in()
    bench.modulator.close()


def test_a_fault_shows_in_the_status(bench: Bench) -> None:
    bench.twin.faults.inject("dlpc900.parked")
    status = bench.modulator.status()
    assert status.state is ModulatorState.FAULT
    assert "mirrors are parked" in status.faults
    assert status.notes == {"power": "normal"}


@pytest.mark.parametrize(
    ("fault", "pulses"),
    [
        ("dlpc900.pulse_lost", 1),
        ("dlpc900.pulse_twice", 3),
        ("dlpc900.suppress_inverted", 1),
        ("dlpc900.count_off", 3),
    ],
)
def test_faults_of_the_trigger_output_are_seen_on_the_line(bench: Bench, fault: str, pulses: int) -> None:
    bench.twin.faults.inject(fault)
    bench.run(SEQUENCE)
    assert len(bench.world.bus.rising("dmd0.out2")) == pulses


# -- what no fault of the twin brings about ----------------------------------------------------------------------


def test_a_register_shorter_than_it_is_and_an_error_register_that_refuses_are_bad_replies(bench: Bench) -> None:
    reads = bench.twin.firmware._reads
    reads[0x0205] = lambda: b"\1\2"
    bench.reopen()
    with pytest.raises(BadReplyError, match=r"firmware version.*2 bytes.*allowed: 16 bytes"):
        bench.modulator.connect()
    reads[0x0100] = lambda: b""
    bench.reopen()
    with pytest.raises(BadReplyError, match="refused to report its error"):
        bench.modulator.connect()


def test_a_device_that_keeps_sending_unasked_is_given_up_in_time(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.modulator.close()
    port = bench.twin.open()
    monkeypatch.setattr(port, "read", lambda timeout_s: bytes(64))
    with pytest.raises(BadReplyError, match="keeps sending without a request"):
        Dlpc900("dmd0", port, bench.world.clock).connect()


def test_mirrors_that_are_parked_when_a_sequence_is_armed_are_a_fault(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.twin.firmware.parked = True
    with pytest.raises(DeviceFaultError, match=r"arm: the device reports mirrors are parked.*check the controller"):
        bench.modulator.arm()


def test_a_fault_that_shows_at_the_end_of_a_sequence_spoils_it(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=1))
    bench.modulator.arm()
    bench.modulator.start()
    bench.twin.firmware._reads[0x1A0A] = lambda: bytes([0x81])
    with pytest.raises(SequenceError, match=r"wait for the end.*sequencer error"):
        bench.modulator.wait_done(60.0)
