"""The open protocol's driver against the reference device: what is shown, and every fault's typed error."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.arrays import U8
from gs2ci_drivers.failures import (
    BadReplyError,
    DeviceFaultError,
    DisconnectedError,
    NoAnswerError,
    RefusedError,
    SequenceError,
    UnsupportedError,
)
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.scpi_modulator.driver import ScpiModulator
from gs2ci_drivers.testing.modulator_bench import ModulatorBench
from gs2ci_sims.wires.scpi_modulator import ScpiModulatorTwin, ScpiPanel
from gs2ci_sims.world import MaskInterval, World
from tests.drivers.faulty import FaultCase, strike

Bench = ModulatorBench[ScpiModulator]


def make_bench(panel: ScpiPanel | None = None) -> Bench:
    world = World()
    twin = ScpiModulatorTwin(world, panel=panel or ScpiPanel(height=30, width=44))
    return Bench(ScpiModulator, "lcos0", twin, world)


@pytest.fixture
def bench() -> Bench:
    bench = make_bench()
    bench.modulator.connect()
    return bench


MASKS: U8 = np.random.default_rng(0).integers(0, 2, (5, 30, 44), dtype=np.uint8)
SEQUENCE = PatternSequence(MASKS, 1, 50e-3, dark_s=1e-3, pause_s=2e-3, repeats=2)


def assert_shown(shown: list[MaskInterval], masks: U8 = MASKS, repeats: int = 2) -> None:
    assert len(shown) == len(masks) * repeats
    for i, interval in enumerate(shown):
        np.testing.assert_array_equal(interval.levels, masks[i % len(masks)])


def test_the_devices_limits_are_read(bench: Bench) -> None:
    info = bench.modulator.info
    assert (info.model, info.serial, info.firmware) == ("GS2CI SCPI-TWIN", "0001", "1.0")
    assert (info.height, info.width, info.pitch_m) == (30, 44, pytest.approx(8e-6))
    assert info.min_exposure_s == {1: pytest.approx(250e-6), 8: pytest.approx(2e-3)}
    assert info.trigger_outs == frozenset(TriggerOut) - {TriggerOut.GATE_PER_MASK}


def test_binary_masks_keep_their_pixels_and_times(bench: Bench) -> None:
    shown = bench.run(SEQUENCE)
    assert_shown(shown)
    assert [interval.end_s - interval.start_s for interval in shown] == pytest.approx([50e-3] * 10)
    assert shown[5].start_s - shown[4].end_s == pytest.approx(2e-3)


def test_grey_masks_keep_their_levels(bench: Bench) -> None:
    masks: U8 = np.random.default_rng(1).integers(0, 256, (3, 30, 44), dtype=np.uint8)
    shown = bench.run(PatternSequence(masks, 8, 5e-3))
    assert_shown(shown, masks, 1)
    assert {interval.top for interval in shown} == {255}


def test_masks_of_ten_bits_are_sent_low_byte_first() -> None:
    bench = make_bench(ScpiPanel(height=30, width=44, shortest_us={10: 100}))
    masks = np.random.default_rng(1).integers(0, 1024, (3, 30, 44), dtype=np.uint16)
    for interval, mask in zip(bench.run(PatternSequence(masks, 10, 5e-3)), masks, strict=True):
        np.testing.assert_array_equal(interval.levels, mask)


def test_a_moving_mask_is_given_no_patterns_and_shows_its_own() -> None:
    bench = make_bench(ScpiPanel(height=30, width=44, built_in=MASKS))
    assert bench.modulator.connect().capacity[1] == 5
    report = bench.modulator.upload(SEQUENCE)
    assert report.payload_bytes == 0
    assert_shown(bench.run(SEQUENCE))


@pytest.mark.parametrize(
    ("trigger", "pulses"),
    [(TriggerOut.PER_EXPOSURE, 2), (TriggerOut.PER_MASK, 10), (TriggerOut.GATE, 2), (TriggerOut.NONE, 0)],
)
def test_the_trigger_output_does_what_the_mode_says(bench: Bench, trigger: TriggerOut, pulses: int) -> None:
    bench.run(replace(SEQUENCE, trigger=trigger))
    assert len(bench.world.bus.rising("lcos0.out")) == pulses


def test_the_upload_takes_about_the_time_that_was_announced(bench: Bench) -> None:
    eta_s = bench.modulator.upload_eta_s(SEQUENCE)
    shares: list[float] = []
    report = bench.modulator.upload(SEQUENCE, shares.append)
    assert report.seconds == pytest.approx(eta_s, rel=0.25)
    assert report.payload_bytes == 5 * 30 * 6
    assert shares[-1] == 1.0


def test_connecting_leaves_a_running_sequence_alone(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    bench.reopen()
    bench.modulator.connect()
    assert bench.modulator.status().state is ModulatorState.RUNNING
    bench.modulator.disarm()
    assert bench.modulator.status().state is ModulatorState.LOADED


def test_a_sequence_without_end_is_not_waited_for_beyond_the_deadline(bench: Bench) -> None:
    bench.modulator.upload(replace(SEQUENCE, repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    with pytest.raises(NoAnswerError, match=r"lcos0: wait for the end.*within 1 s"):
        bench.modulator.wait_done(1.0)


def test_another_protocol_version_is_refused(bench: Bench) -> None:
    bench.reopen()
    bench.twin._commands["SYST:VERS?"] = lambda _: "GS2CI-MOD,9"
    with pytest.raises(UnsupportedError, match=r"GS2CI-MOD,9.*allowed: GS2CI-MOD,1.*docs/scpi-modulator.md"):
        bench.modulator.connect()


def connect_and_look(lcos: ScpiModulator) -> None:
    lcos.connect()
    lcos.status()


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("*IDN?", "one,two"),
        ("MOD:SIZE?", "30"),
        ("MOD:SIZE?", "30,x"),
        ("MOD:KIND?", "LASER"),
        ("MOD:STATE?", "ASLEEP"),
    ],
)
def test_an_answer_of_the_wrong_form_is_named(bench: Bench, command: str, answer: str) -> None:
    bench.reopen()
    bench.twin._commands[command] = lambda _: answer
    with pytest.raises(BadReplyError, match=f"lcos0.*{command[:3].replace('*', '.')}.*allowed"):
        connect_and_look(bench.modulator)


CASES = [
    FaultCase("serial.reply_lost", "SEQ:NEW", None),
    FaultCase("serial.reply_lost", "SEQ:NEW", NoAnswerError, "SEQ:NEW 5,1: no answer within 2 s", times=2),
    FaultCase("serial.reply_lost", "SEQ:DATA", NoAnswerError, "SEQ:DATA 2", skip=2),
    FaultCase("serial.reply_lost", "SEQ:START", NoAnswerError, "SEQ:START"),
    FaultCase("serial.reply_lost", "MOD:STATE?", None),
    FaultCase("serial.reply_late", "SEQ:TIME", None, value=3.0),
    FaultCase("serial.reply_late", "SEQ:START", NoAnswerError, "SEQ:START", value=3.0),
    FaultCase("serial.reply_twice", "SEQ:", None, times=4),
    FaultCase("serial.reply_spoilt", "SEQ:END", None),
    FaultCase("serial.reply_spoilt", "SEQ:DATA", BadReplyError, "SEQ:DATA 0.*bad reply"),
    FaultCase("serial.reply_cut", "SEQ:REP", None),
    FaultCase("serial.reply_in_pieces", "SEQ:OUT", None),
    FaultCase("serial.replies_joined", "SEQ:OUT", None),
    FaultCase("serial.noise", "SEQ:ARM", None),
    FaultCase("serial.babble", "SEQ:ARM", None),
    FaultCase("serial.babble", "SEQ:DATA", BadReplyError, "SEQ:DATA 0: bad reply"),
    FaultCase("serial.request_lost", "SEQ:TIME", None),
    FaultCase("serial.request_lost", "SEQ:START", NoAnswerError, "SEQ:START"),
    FaultCase("serial.write_stuck", "SEQ:NEW", None),
    FaultCase("serial.write_stuck", "SEQ:DATA", NoAnswerError, "SEQ:DATA 0"),
    *(
        FaultCase("serial.unplugged", about, DisconnectedError, "device is gone")
        for about in (
            "SEQ:STOP",
            "SEQ:NEW",
            "SEQ:DATA",
            "SEQ:TIME",
            "SEQ:END",
            "SEQ:ARM",
            "SEQ:START",
            "MOD:STATE?",
        )
    ),
    FaultCase("scpi.refuses", "SEQ:NEW", RefusedError, "-200 .Execution error"),
    FaultCase("scpi.refuses", "SEQ:END", RefusedError, "-221 .Settings conflict", value=-221),
    FaultCase("scpi.refuses", "SEQ:START", RefusedError, "-999 .Device error", value=-999),
    FaultCase("scpi.block_spoilt", "", RefusedError, "SEQ:DATA 0: refused with -160 .Block data error"),
    FaultCase("scpi.block_short", "", RefusedError, "SEQ:DATA 0: refused with -160 .Block data error"),
    FaultCase("scpi.fault", "SEQ:ARM", RefusedError, "-240 .Hardware error"),
    FaultCase("scpi.fault", "SEQ:END", DeviceFaultError, "over-temperature"),
    FaultCase("scpi.fault", "SEQ:SHOWN", None),
    FaultCase("scpi.restarts", "SEQ:TIME", RefusedError, "-221"),
    FaultCase("scpi.restarts", "SEQ:ARM", RefusedError, "-221"),
    FaultCase("scpi.restarts", "SEQ:SHOWN", SequenceError, "0 masks were shown and 10 planned"),
    FaultCase("panel.stops_early", "", SequenceError, "3 masks were shown and 10 planned", skip=3),
    FaultCase("panel.mask_skipped", "", SequenceError, "9 masks were shown and 10 planned", skip=3),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_fault_is_ridden_out_or_a_typed_error_in_time_and_the_next_show_works(bench: Bench, case: FaultCase) -> None:
    strike(bench, case, SEQUENCE, assert_shown, lambda: setattr(bench.twin, "fault", ""))


def test_a_command_that_must_not_be_repeated_is_not(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.modulator.arm()
    bench.twin.faults.inject("serial.reply_lost", about="SEQ:START")
    with pytest.raises(NoAnswerError):
        bench.modulator.start()
    bench.world.clock.sleep_s(1.0)
    assert len(bench.world.bus.rising("lcos0.out")) == 2, "one start, two passes"
    assert not bench.modulator.incidents


def test_what_was_ridden_out_is_noted(bench: Bench) -> None:
    bench.twin.faults.inject("serial.reply_lost", about="SEQ:END")
    bench.run(SEQUENCE)
    (incident,) = bench.modulator.incidents
    assert "SEQ:END" in incident
    assert "asked again" in incident


def test_a_stale_answer_of_an_earlier_session_is_thrown_away(bench: Bench) -> None:
    bench.twin.faults.inject("serial.stale")
    bench.reopen()
    assert bench.modulator.connect().height == 30


def test_a_power_cycle_forgets_the_sequence_and_the_next_session_starts_over(bench: Bench) -> None:
    bench.run(SEQUENCE)
    bench.twin.power_cycle()
    with pytest.raises(DisconnectedError, match="gone"):
        bench.modulator.arm()
    bench.reopen()
    bench.modulator.connect()
    assert bench.modulator.status().state is ModulatorState.IDLE
    assert_shown(bench.run(SEQUENCE))


def test_a_fault_shows_in_the_status(bench: Bench) -> None:
    bench.twin.fault = "over-temperature"
    status = bench.modulator.status()
    assert status.state is ModulatorState.FAULT
    assert status.faults == ("over-temperature",)


def test_an_error_queue_that_cannot_be_read_is_a_bad_reply(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    exchange = bench.modulator._link._exchange

    def refused(chunks: list[bytes], asked: str) -> str:
        return {"SEQ:STOP": "ERR", "SYST:ERR?": "what?"}.get(asked) or exchange(chunks, asked)

    monkeypatch.setattr(bench.modulator._link, "_exchange", refused)
    with pytest.raises(BadReplyError, match=r"SYST:ERR\?.*error entry 'what\?'"):
        bench.modulator.disarm()
