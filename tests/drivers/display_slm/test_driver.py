"""The experimental panel driver against its twin: grey levels, the host's timetable, every fault's typed error."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci.core.arrays import U8
from gs2ci_drivers.display_slm.driver import DisplaySlm
from gs2ci_drivers.display_slm.options import DisplaySlmOptions
from gs2ci_drivers.failures import (
    BadReplyError,
    DisconnectedError,
    NoAnswerError,
    RefusedError,
    SequenceError,
    UnsupportedError,
)
from gs2ci_drivers.modulator import ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.testing.modulator_bench import ModulatorBench
from gs2ci_sims.wires.display_slm import DisplaySlmTwin
from gs2ci_sims.world import MaskInterval, World
from tests.drivers.faulty import FaultCase, strike

Bench = ModulatorBench[DisplaySlm]


def make_bench(settings: DisplaySlmOptions | None = None) -> Bench:
    world = World()
    return Bench(DisplaySlm, "slm0", DisplaySlmTwin(world), world, settings)


@pytest.fixture
def bench() -> Bench:
    bench = make_bench()
    bench.modulator.connect()
    return bench


MASKS: U8 = np.random.default_rng(0).integers(0, 2, (3, 1200, 1920), dtype=np.uint8)
SEQUENCE = PatternSequence(MASKS, 1, 0.2, dark_s=0.0, pause_s=0.3, repeats=2, trigger=TriggerOut.PER_MASK)


def assert_shown(shown: list[MaskInterval], repeats: int = 2) -> None:
    assert len(shown) == len(MASKS) * repeats
    for i, interval in enumerate(shown):
        np.testing.assert_array_equal(interval.levels, MASKS[i % 3].astype(np.uint16) * 1023)


def test_it_says_that_it_is_experimental_and_stepped_by_the_host(bench: Bench) -> None:
    info = bench.modulator.info
    assert info.experimental
    assert not info.hardware_timed
    assert info.start_latency_s is None
    assert (info.height, info.width, info.serial) == (1200, 1920, "2018021101")


def test_masks_are_shown_on_the_hosts_timetable_with_a_pulse_each(bench: Bench) -> None:
    shown = bench.run(SEQUENCE)
    assert_shown(shown)
    begins = [interval.start_s for interval in shown]
    assert np.diff(begins) == pytest.approx([0.2, 0.2, 0.5, 0.2, 0.2], abs=1e-3)
    assert bench.world.bus.rising("slm0.out") == pytest.approx(begins)


def test_without_a_trigger_nothing_pulses_and_dark_times_are_kept(bench: Bench) -> None:
    shown = bench.run(replace(SEQUENCE, trigger=TriggerOut.NONE, dark_s=0.1))
    assert_shown(shown)
    assert [later.start_s - one.end_s for one, later in pairwise(shown)] == pytest.approx(
        [0.1, 0.1, 0.3, 0.1, 0.1], abs=2e-3
    )
    assert not bench.world.bus.rising("slm0.out")


@pytest.mark.parametrize("trigger", [TriggerOut.PER_EXPOSURE, TriggerOut.GATE])
def test_a_trigger_per_exposure_cannot_be_had(bench: Bench, trigger: TriggerOut) -> None:
    with pytest.raises(UnsupportedError, match="none, per-mask"):
        bench.modulator.upload(replace(SEQUENCE, trigger=trigger))


def test_grey_levels_lie_between_dark_and_bright() -> None:
    bench = make_bench(DisplaySlmOptions(dark_level=200, bright_level=700))
    mask = np.array([[0, 255, 51]], np.uint8)
    assert bench.modulator.levels(mask, 8).tolist() == [[200, 700, 300]]
    inverse = make_bench(DisplaySlmOptions(dark_level=700, bright_level=200))
    assert inverse.modulator.levels(mask, 8).tolist() == [[700, 200, 600]]


@pytest.mark.parametrize(("dark", "bright"), [(0, 0), (-1, 5), (0, 1024)])
def test_levels_that_are_no_levels_are_refused(dark: int, bright: int) -> None:
    with pytest.raises(ValidationError, match=r"1023|greater than or equal to 0"):
        DisplaySlmOptions(dark_level=dark, bright_level=bright)


def test_disarming_shows_the_dark_level(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.modulator.arm()
    bench.modulator.start()
    assert bench.modulator.status().state is ModulatorState.RUNNING
    bench.modulator.disarm()
    now_s = bench.world.clock.now_s()
    bench.world.clock.sleep_s(1.0)
    assert not bench.world.masks_between(now_s, now_s + 1.0)
    assert bench.modulator.status().state is ModulatorState.LOADED


def test_waiting_has_a_deadline_and_can_go_on(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    with pytest.raises(NoAnswerError, match=r"within 0\.5"):
        bench.modulator.wait_done(0.5)
    bench.modulator.wait_done(5.0)
    assert_shown(list(bench.world.masks_between(begin_s, bench.world.clock.now_s())))


def test_a_host_that_is_late_says_so(bench: Bench) -> None:
    bench.modulator.upload(SEQUENCE)
    bench.modulator.arm()
    bench.modulator.start()
    bench.world.clock.sleep_s(0.5)
    with pytest.raises(SequenceError, match=r"show mask 1.*3\d\d ms late.*late_s"):
        bench.modulator.wait_done(5.0)


CASES = [
    FaultCase("slm.refuses", "MI 2", RefusedError, "MI 2: refused with NG"),
    FaultCase("slm.refuses", "image", RefusedError, "image for slot 1: refused with NG"),
    FaultCase("slm.refuses", "DS 1", RefusedError, "DS 1"),
    FaultCase("slm.busy", "VI 0", None, value=5.0),
    FaultCase("slm.busy", "VI 0", NoAnswerError, "VI 0: no answer", value=80.0),
    FaultCase("slm.no_response", "TM 1", NoAnswerError, "TM 1: no answer within 1.5"),
    FaultCase("slm.row_lost", "", RefusedError, "image for slot 1"),
    FaultCase("slm.pixel_spoilt", "", RefusedError, "image for slot 1"),
    FaultCase("slm.wrong_kind", "", BadReplyError, "frame of kind 9"),
    FaultCase("serial.reply_lost", "status", None),
    FaultCase("serial.reply_lost", "status", NoAnswerError, "no answer within", times=40),
    FaultCase("serial.reply_late", "status", None, value=0.7),
    FaultCase("serial.reply_cut", "status", None),
    FaultCase("serial.reply_twice", "status", None),
    FaultCase("serial.noise", "status", None),
    FaultCase("serial.babble", "status", None),
    FaultCase("serial.write_stuck", "", NoAnswerError, "write"),
    *(
        FaultCase("serial.unplugged", about, DisconnectedError, "device is gone")
        for about in ("GS 0", "VI 0", "MI 3", "\x03\ufffd\0\x04", "TM 1", "DS 2")
    ),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_fault_is_ridden_out_or_a_typed_error_in_time_and_the_next_show_works(bench: Bench, case: FaultCase) -> None:
    def wait_until_it_is_no_longer_busy() -> None:
        if case.value > 30.0:
            bench.world.clock.sleep_s(case.value)

    strike(bench, replace(case, within_s=110.0), SEQUENCE, assert_shown, wait_until_it_is_no_longer_busy)


def test_a_stale_answer_of_an_earlier_session_is_thrown_away(bench: Bench) -> None:
    bench.twin.faults.inject("serial.stale")
    bench.reopen()
    assert bench.modulator.connect().serial == "2018021101"


def test_a_power_cycle_empties_the_slots(bench: Bench) -> None:
    bench.run(SEQUENCE)
    bench.twin.power_cycle()
    with pytest.raises(DisconnectedError):
        bench.modulator.arm()
    bench.reopen()
    assert not bench.twin.slots
    assert_shown(bench.run(SEQUENCE))


def test_a_panel_that_babbles_without_end_does_not_hold_the_driver_beyond_its_deadline() -> None:
    class Babbler:
        def __init__(self) -> None:
            self.reads = 0

        def write(self, data: bytes, timeout_s: float) -> None: ...

        def read(self, max_bytes: int, timeout_s: float) -> bytes:
            world.clock.sleep_s(0.01)
            self.reads += 1
            assert self.reads < 2000, "this goes on for ever"
            return b"noise"

        def close(self) -> None: ...

    world = World()
    with pytest.raises(NoAnswerError, match="SN: no answer"):
        DisplaySlm("slm0", Babbler(), world.clock).connect()


def test_a_panel_that_is_busy_takes_no_command_and_gets_it_again(bench: Bench) -> None:
    """BS says that a command was not taken (SlmCtrl.m, CheckRecv; SLM_Ctrl_ReadSU: about 40 s after power-on)."""
    bench.modulator.upload(SEQUENCE)
    bench.twin.faults.inject("slm.busy", about="TM 1", value=39.0)
    assert_shown(bench.run(SEQUENCE))
    assert len(bench.world.bus.rising("slm0.out")) == 2 * len(MASKS)


def test_the_change_to_memory_mode_takes_forty_seconds_once(bench: Bench) -> None:
    for least_s, most_s in ((40.0, 43.0), (0.0, 3.0)):
        begin_s = bench.world.clock.now_s()
        bench.modulator.upload(SEQUENCE)
        assert least_s <= bench.world.clock.now_s() - begin_s < most_s


def test_a_phase_table_of_another_program_is_another_panel() -> None:
    bench, other = make_bench(), make_bench()
    other.twin.table = "1064 2.0"
    models = [one.modulator.connect().model for one in (bench, other)]
    assert models == ["Santec SLM-200 class, phase table 633 2.0", "Santec SLM-200 class, phase table 1064 2.0"]


def test_what_another_program_left_running_shows_nothing_out_of_turn(bench: Bench) -> None:
    bench.twin.trigger_input = bench.twin.playing = True
    bench.modulator.upload(SEQUENCE)
    bench.world.clock.after(1.0, bench.twin.trigger)
    assert_shown(bench.run(SEQUENCE))
    assert bench.modulator.incidents == ["slm0: the trigger input was on, which shows slots out of turn: switched off"]


@pytest.mark.parametrize(("word", "error"), [("ER", RefusedError), ("TO", NoAnswerError)])
def test_a_panels_own_errors_are_no_values(word: str, error: type[Exception]) -> None:
    """SlmCtrl.m: ER is an error as NG is (CheckRecv), TO means that there is no response yet (RequestReceiveData)."""
    bench = make_bench()
    bench.twin._obey = lambda head, numbers: word  # type: ignore[method-assign]
    with pytest.raises(error):
        bench.modulator.connect()
