"""The modulator contract, to be run on every implementation through its twin.

Required fixtures: `bench`, a connected `TwinBench`, closed in the end; `unconnected`, another before `connect`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from gs2ci_drivers.failures import (
    DisconnectedError,
    DriverError,
    NoAnswerError,
    OutOfRangeError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.modulator import Modulator, ModulatorState
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.testing.modulator_bench import ModulatorBench


@dataclass
class TwinBench(ModulatorBench[Modulator]):
    """A modulator on its twin, with what a test needs to know of the twin.

    Args:
        pulse_line: The trigger line on the world's bus that pulses.
        gate_line: The one that is held at a level; for most devices the same.
        stale: The twin's fault that leaves an answer of an earlier session on the line.
        cell: Modulator pixels per side of one of the 12 x 16 cells that the masks of these tests have.
        exclusive: Whether the port serves one session at a time; windows of a video output do not.
    """

    pulse_line: str = ""
    gate_line: str = ""
    stale: str = "serial.stale"
    cell: int = 8
    exclusive: bool = True

    def sequence(self, count: int = 4, bits: int = 1, **changes: Any) -> PatternSequence:
        """Return masks of coarse superpixels at ten times the shortest exposure."""
        info = self.modulator.info
        cells = np.random.default_rng(count).integers(0, 1 << bits, (count, 12, 16), dtype=np.uint8)
        masks = np.zeros((count, info.height, info.width), np.uint8)
        masks[:, : 12 * self.cell, : 16 * self.cell] = np.kron(cells, np.ones((1, self.cell, self.cell), np.uint8))
        exposure_s = max(10 * info.min_exposure_s[bits], 20e-3)
        trigger = TriggerOut.PER_MASK
        return replace(PatternSequence(masks, bits, exposure_s, pause_s=2 * exposure_s, trigger=trigger), **changes)

    def play(self, sequence: PatternSequence) -> list[Any]:
        """Show a sequence; return the masks that were shown."""
        return self.run(sequence, sequence.duration_s + 1.0)

    def dark_for(self, duration_s: float) -> bool:
        begin_s = self.world.clock.now_s()
        self.world.clock.sleep_s(duration_s)
        return not self.world.masks_between(begin_s, begin_s + duration_s)


def assert_shows(bench: TwinBench, shown: list[Any], sequence: PatternSequence) -> None:
    """Compare the masks that were shown with the masks of a sequence."""
    rows, columns = 12 * bench.cell, 16 * bench.cell
    assert len(shown) == sequence.count * sequence.repeats
    for i, interval in enumerate(shown):
        lit, levels = sequence.masks[sequence.order[i % sequence.count], :rows, :columns], interval.levels
        # As shares of full transmission, whatever levels the device uses.
        shares = levels[:rows, :columns] / interval.top
        np.testing.assert_allclose(shares, lit / (2**sequence.bit_depth - 1), atol=5e-4)
        assert not levels[rows:].any()
        assert not levels[:, columns:].any()


def test_what_it_is_is_not_known_before_it_is_connected(unconnected: TwinBench) -> None:
    with pytest.raises(WrongStateError, match=r"info: not connected.*call connect\(\) first"):
        _ = unconnected.modulator.info


def test_connecting_is_idempotent_and_shows_nothing(bench: TwinBench) -> None:
    assert bench.modulator.connect() == bench.modulator.connect() == bench.modulator.info
    assert bench.dark_for(1.0)
    assert not bench.world.bus.edges


def test_limits_are_sane(bench: TwinBench) -> None:
    info = bench.modulator.info
    assert info.min_exposure_s.keys() == info.capacity.keys()
    assert all(0 < shortest < info.max_exposure_s for shortest in info.min_exposure_s.values())
    assert all(most >= 8 for most in info.capacity.values())
    assert TriggerOut.NONE in info.trigger_outs
    assert info.exposure_step_s > 0
    assert info.pitch_m > 1e-6
    assert info.hardware_timed == (info.start_latency_s is not None)


@pytest.mark.parametrize("bits", [1, 8])
def test_the_uploaded_masks_are_shown_in_order_and_in_time(bench: TwinBench, bits: int) -> None:
    if bits not in bench.modulator.info.min_exposure_s:
        pytest.skip(f"masks of {bits} bits are not among what it shows")
    sequence = bench.modulator.check(bench.sequence(bits=bits, repeats=2))
    shown = bench.play(sequence)
    assert_shows(bench, shown, sequence)
    starts = np.array([interval.start_s for interval in shown]) - shown[0].start_s
    windows = sequence.windows_s()
    tolerance_s = 1e-6 if bench.modulator.info.hardware_timed else 5e-3
    np.testing.assert_allclose(starts[: sequence.count], windows[:, 0], atol=tolerance_s)
    assert starts[sequence.count] == pytest.approx(sequence.period_s, abs=tolerance_s)
    durations = [interval.end_s - interval.start_s for interval in shown]
    np.testing.assert_allclose(durations, sequence.exposure_s, atol=tolerance_s)


@pytest.mark.parametrize("bits", [1, 8])
def test_a_turned_sequence_begins_with_another_mask_and_shows_all(bench: TwinBench, bits: int) -> None:
    if bits not in bench.modulator.info.min_exposure_s:
        pytest.skip(f"masks of {bits} bits are not among what it shows")
    sequence = bench.modulator.check(bench.sequence(5, bits=bits, repeats=2))
    bench.modulator.upload(sequence)
    for first in (3, 1, 1, 0):
        bench.modulator.turn(first)
        turned = replace(sequence, first=first)
        assert bench.modulator.loaded is not None
        assert bench.modulator.loaded.first == first
        bench.modulator.arm()
        begin_s = bench.world.clock.now_s()
        bench.modulator.start()
        bench.modulator.wait_done(sequence.duration_s + 1.0)
        assert_shows(bench, list(bench.world.masks_between(begin_s, bench.world.clock.now_s())), turned)
        bench.modulator.disarm()
    assert_shows(bench, bench.play(replace(sequence, first=4)), replace(sequence, first=4))


def test_a_mask_that_there_is_not_begins_no_sequence(bench: TwinBench) -> None:
    with pytest.raises(WrongStateError, match=r"turn.*call upload\(\) first"):
        bench.modulator.turn(1)
    bench.modulator.upload(bench.sequence(4))
    for first in (-1, 4):
        with pytest.raises(OutOfRangeError, match=r"modulator0.*allowed: 0 to 3"):
            bench.modulator.turn(first)


def test_dark_times_lie_between_masks(bench: TwinBench) -> None:
    sequence = bench.sequence()
    sequence = replace(sequence, dark_s=sequence.exposure_s)
    shown = bench.play(sequence)
    assert_shows(bench, shown, sequence)
    gaps = np.diff([interval.start_s for interval in shown]) - sequence.exposure_s
    np.testing.assert_allclose(gaps, sequence.dark_s, atol=5e-3)


def test_a_sequence_without_any_dark_time_comes_to_its_end(bench: TwinBench) -> None:
    step_s = bench.modulator.info.exposure_step_s
    for steps in (1, 3, 7):
        sequence = bench.sequence(3)
        exposure_s = sequence.exposure_s + steps * step_s
        sequence = replace(sequence, exposure_s=exposure_s, pause_s=0.0, repeats=3)
        assert_shows(bench, bench.play(sequence), sequence)
        assert bench.dark_for(0.1)


def test_the_first_mask_comes_within_the_promised_latency(bench: TwinBench) -> None:
    latency_s = bench.modulator.info.start_latency_s
    if latency_s is None:
        pytest.skip("the host times each mask")
    bench.modulator.upload(bench.sequence())
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    bench.world.clock.sleep_s(latency_s)
    (first, *_) = bench.world.masks_between(begin_s, bench.world.clock.now_s())
    assert first.start_s - begin_s <= latency_s


@pytest.mark.parametrize("trigger", TriggerOut)
def test_the_trigger_output_does_what_is_asked_or_the_upload_is_refused(bench: TwinBench, trigger: TriggerOut) -> None:
    sequence = bench.sequence(repeats=2, trigger=trigger)
    each = trigger is TriggerOut.GATE_PER_MASK
    if each:  # the line has to fall between masks
        sequence = replace(sequence, dark_s=sequence.exposure_s)
    if trigger not in bench.modulator.info.trigger_outs:
        with pytest.raises(UnsupportedError, match=f"modulator0.*{trigger.value}.*allowed"):
            bench.modulator.upload(sequence)
        assert bench.modulator.loaded is None
        return
    bench.modulator.upload(sequence)
    bench.world.bus.edges.clear()
    shown = bench.play(sequence)
    line = bench.gate_line if trigger is TriggerOut.GATE or each else bench.pulse_line
    rises = bench.world.bus.rising(line)
    per_pass = {TriggerOut.NONE: 0, TriggerOut.PER_MASK: sequence.count, TriggerOut.GATE_PER_MASK: sequence.count}.get(
        trigger, 1
    )
    assert sequence.pulses == 2 * per_pass
    assert len(rises) == 2 * per_pass
    if per_pass:
        first_of_each = [shown[i].start_s for i in range(0, len(shown), sequence.count // per_pass)]
        np.testing.assert_allclose(rises, first_of_each, atol=1e-6)
    if trigger is TriggerOut.GATE or each:
        falls = [edge.when_s for edge in bench.world.bus.edges if edge.line == line and not edge.level]
        held_s = sequence.exposure_s * (1 if each else sequence.count)
        np.testing.assert_allclose(np.subtract(falls, rises), held_s, atol=1e-6)


def test_check_returns_the_times_that_the_device_keeps(bench: TwinBench) -> None:
    info = bench.modulator.info
    sequence = bench.sequence()
    checked = bench.modulator.check(replace(sequence, exposure_s=sequence.exposure_s + info.exposure_step_s * 0.3))
    assert checked.exposure_s == pytest.approx(sequence.exposure_s, abs=info.exposure_step_s * 1e-3)


REFUSED = {
    "shape": lambda info, s: replace(s, masks=s.masks[:, :-1]),
    "no masks": lambda info, s: replace(s, masks=s.masks[:0]),
    "depth": lambda info, s: replace(s, bit_depth=16),
    "levels": lambda info, s: replace(s, masks=s.masks * 2),
    "type": lambda info, s: replace(s, masks=s.masks.astype(np.float32)),
    "too many": lambda info, s: replace(
        s, masks=np.broadcast_to(s.masks[:1], (info.capacity[1] + 1, info.height, info.width))
    ),
    "too short": lambda info, s: replace(s, exposure_s=info.min_exposure_s[1] - info.exposure_step_s),
    "too long": lambda info, s: replace(s, exposure_s=info.max_exposure_s * 1.1),
    "negative dark": lambda info, s: replace(s, dark_s=-1e-3),
    "negative repeats": lambda info, s: replace(s, repeats=-1),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_sequence_beyond_the_limits_is_refused_with_what_is_allowed_and_nothing_changes(
    bench: TwinBench, what: str
) -> None:
    good = bench.sequence()
    bench.modulator.upload(good)
    loaded = bench.modulator.loaded
    bad = REFUSED[what](bench.modulator.info, good)
    if what == "too short" and bench.modulator.info.min_exposure_s[1] <= bench.modulator.info.exposure_step_s:
        bad = replace(good, exposure_s=0.0)
    for call in (bench.modulator.check, bench.modulator.upload_eta_s, bench.modulator.upload):
        with pytest.raises(OutOfRangeError, match=r"modulator0.*allowed"):
            call(bad)
    assert bench.modulator.loaded is loaded
    bench.modulator.arm()


def test_calls_in_the_wrong_order_are_refused_with_the_right_one(bench: TwinBench) -> None:
    with pytest.raises(WrongStateError, match=r"arm.*call upload\(\) first"):
        bench.modulator.arm()
    with pytest.raises(WrongStateError, match=r"start.*call arm\(\) first"):
        bench.modulator.start()
    bench.modulator.upload(bench.sequence())
    with pytest.raises(WrongStateError, match=r"call arm\(\) first"):
        bench.modulator.start()


def test_every_start_needs_an_arm_and_shows_the_same_again(bench: TwinBench) -> None:
    sequence = bench.sequence()
    assert_shows(bench, bench.play(sequence), sequence)
    with pytest.raises(WrongStateError, match="not armed"):
        bench.modulator.start()
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    bench.modulator.wait_done(sequence.duration_s + 1.0)
    assert_shows(bench, list(bench.world.masks_between(begin_s, bench.world.clock.now_s())), sequence)


def test_disarming_is_allowed_in_every_state_and_leaves_it_dark(bench: TwinBench) -> None:
    modulator = bench.modulator
    endless = bench.sequence(repeats=0)

    def begin() -> None:
        modulator.arm()
        modulator.start()

    steps: list[Callable[[], object]] = [lambda: None, lambda: modulator.upload(endless), modulator.arm, begin]
    for step in steps:
        step()
        modulator.disarm()
        modulator.disarm()
        assert bench.dark_for(0.5)
        with pytest.raises(WrongStateError):
            modulator.start()
    assert modulator.loaded is not None


def test_masks_are_shown_in_time_while_somebody_else_is_served(bench: TwinBench) -> None:
    sequence = bench.sequence()
    bench.modulator.upload(sequence)
    bench.modulator.arm()
    begin_s = bench.world.clock.now_s()
    bench.modulator.start()
    for i in range(sequence.count + 1):
        bench.modulator.keep_time(begin_s + 5e-3 + (i + 1) * sequence.exposure_s)
    assert bench.world.clock.now_s() >= begin_s + sequence.count * sequence.exposure_s
    assert_shows(bench, list(bench.world.masks_between(begin_s, bench.world.clock.now_s())), sequence)
    bench.modulator.wait_done(sequence.duration_s)


def test_waiting_has_a_deadline(bench: TwinBench) -> None:
    bench.modulator.upload(bench.sequence(repeats=0))
    bench.modulator.arm()
    bench.modulator.start()
    begin_s = bench.world.clock.now_s()
    with pytest.raises(NoAnswerError, match="modulator0"):
        bench.modulator.wait_done(2.0)
    assert 1.9 <= bench.world.clock.now_s() - begin_s < 3.0


def test_the_status_follows_the_calls(bench: TwinBench) -> None:
    modulator = bench.modulator
    assert modulator.status().state is ModulatorState.IDLE
    modulator.upload(bench.sequence(repeats=0))
    assert modulator.status().state is ModulatorState.LOADED
    modulator.arm()
    assert modulator.status().state is ModulatorState.ARMED
    modulator.start()
    bench.world.clock.sleep_s(modulator.info.start_latency_s or 0.0)
    assert modulator.status().state is ModulatorState.RUNNING
    modulator.disarm()
    assert modulator.status().state is ModulatorState.LOADED
    assert not modulator.status().faults


def test_the_upload_takes_about_the_time_that_was_announced_and_reports_progress(bench: TwinBench) -> None:
    sequence = bench.sequence(8)
    eta_s = bench.modulator.upload_eta_s(sequence)
    shares: list[float] = []
    report = bench.modulator.upload(sequence, shares.append)
    assert report.sequence == bench.modulator.loaded
    assert report.payload_bytes > 0
    assert report.seconds == pytest.approx(eta_s, rel=0.3, abs=0.2)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_close_may_be_called_twice_and_calls_after_it_are_refused(bench: TwinBench) -> None:
    modulator = bench.modulator
    modulator.close()
    modulator.close()
    for call in (
        modulator.connect,
        modulator.status,
        modulator.disarm,
        lambda: modulator.wait_done(1.0),
        lambda: modulator.keep_time(1.0),
    ):
        with pytest.raises(WrongStateError, match="closed"):
            call()


def test_a_new_session_survives_stale_answers_and_works(bench: TwinBench) -> None:
    bench.play(bench.sequence())
    info = bench.modulator.info
    bench.modulator.close()
    bench.twin.faults.inject(bench.stale)
    bench.modulator = bench.open()
    assert bench.modulator.connect() == info
    sequence = bench.sequence(5)
    assert_shows(bench, bench.play(sequence), sequence)


def test_a_port_that_is_in_use_cannot_be_opened_twice(bench: TwinBench) -> None:
    if not bench.exclusive:
        pytest.skip("a window system lets anybody cover an output")
    with pytest.raises(OSError, match="busy"):
        bench.open()


@pytest.mark.parametrize("moment", ["connect", "upload", "arm", "start", "wait_done", "disarm", "status"])
def test_unplugging_is_a_typed_error_at_every_step_and_the_next_session_works(bench: TwinBench, moment: str) -> None:
    sequence = bench.sequence()
    modulator = bench.modulator
    modulator.upload(sequence)
    modulator.arm()
    if moment == "wait_done":
        modulator.start()
    if moment == "connect":
        modulator.close()
        modulator = bench.modulator = bench.open()
    bench.twin.unplug()
    calls: dict[str, Callable[[], object]] = {
        "connect": modulator.connect,
        "upload": lambda: modulator.upload(sequence),
        "arm": modulator.arm,
        "start": modulator.start,
        "wait_done": lambda: modulator.wait_done(5.0),
        "disarm": modulator.disarm,
        "status": modulator.status,
    }
    with pytest.raises(DisconnectedError, match=r"modulator0.*gone"):
        calls[moment]()
    if moment not in {"connect", "status"}:
        with pytest.raises(DriverError):
            modulator.disarm()
    modulator.close()
    bench.twin.plug_in()
    bench.modulator = bench.open()
    bench.modulator.connect()
    bench.modulator.disarm()
    assert_shows(bench, bench.play(sequence), sequence)
