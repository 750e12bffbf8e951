"""The panel that the LCoS-like twins have in common: response, sequences, trigger line."""

import numpy as np
import pytest

from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.panel import Out, Panel, Show
from gs2ci_sims.world import World

MASKS = [np.full((2, 3), level, np.uint8) for level in (255, 0, 51)]


def transmitted_s(world: World, begin_s: float, end_s: float) -> float:
    """Integrate the first pixel's transmission over time."""
    return sum(
        float(shown.levels[0, 0]) / shown.top * (shown.end_s - shown.start_s)
        for shown in world.masks_between(begin_s, end_s)
    )


def test_without_response_time_a_mask_is_there_at_once_as_it_was_given() -> None:
    world = World()
    Panel(world, "p.out", FaultSet()).set(MASKS[2], 255)
    world.clock.sleep_s(1.0)
    (shown,) = world.masks_between(0.0, world.clock.now_s())
    assert shown.levels is MASKS[2]


def test_the_response_is_first_order_with_its_time_constant() -> None:
    world = World()
    panel = Panel(world, "p.out", FaultSet(), response_s=0.01)
    begin_s = world.clock.now_s()
    panel.set(MASKS[0], 255)
    world.clock.sleep_s(0.2)
    middle_s = world.clock.now_s()
    # Rising like 1 - exp(-t/τ) loses τ, falling like exp(-t/τ) gains it back.
    assert transmitted_s(world, begin_s, middle_s) == pytest.approx(0.2 - 0.01, abs=2e-5)
    panel.set(None)
    world.clock.sleep_s(0.2)
    assert transmitted_s(world, middle_s, world.clock.now_s()) == pytest.approx(0.01, abs=2e-5)
    assert not world.masks_between(world.clock.now_s() - 0.01, world.clock.now_s())


def test_a_mask_that_comes_before_the_last_has_settled_takes_over() -> None:
    world = World()
    panel = Panel(world, "p.out", FaultSet(), response_s=0.01)
    panel.set(MASKS[0], 255)
    world.clock.sleep_s(0.005)
    panel.set(MASKS[2], 255)
    world.clock.sleep_s(0.5)
    (*_, last) = world.masks_between(0.0, world.clock.now_s())
    assert last.levels is MASKS[2]
    assert last.top == 255


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0, 20.0])
def test_masks_shorter_than_the_response_go_on_from_where_the_pixels_are(ratio: float) -> None:
    """The relaxation written out: a mask of length T starts from the level s that the one before has reached."""
    world, tau_s = World(), 0.01
    panel, interval_s = Panel(world, "p.out", FaultSet(), response_s=tau_s), ratio * tau_s
    level = 0.0
    for mask in MASKS * 2:
        begin_s, target = world.clock.now_s(), float(mask[0, 0]) / 255
        panel.set(mask, 255)
        world.clock.sleep_s(interval_s)
        expected_s = target * interval_s + (level - target) * tau_s * -np.expm1(-ratio)
        assert transmitted_s(world, begin_s, begin_s + interval_s) == pytest.approx(expected_s, abs=2e-5)
        level = target + (level - target) * np.exp(-ratio)


@pytest.mark.parametrize(("out", "rises"), [(Out.NONE, 0), (Out.EXPOSURE, 2), (Out.GATE, 2), (Out.MASK, 6)])
def test_a_sequence_is_played_with_its_trigger(out: Out, rises: int) -> None:
    world = World()
    panel = Panel(world, "p.out", FaultSet())
    panel.play(Show(MASKS, 255, 1e-3, 1e-4, 5e-4, 2, out), 1e-3)
    begin_s = world.clock.now_s()
    world.clock.sleep_s(0.1)
    shown = world.masks_between(begin_s, world.clock.now_s())
    assert [interval.levels[0, 0] for interval in shown] == [255, 0, 51] * 2
    assert shown[3].start_s - shown[2].end_s == pytest.approx(5e-4)
    assert len(world.bus.rising("p.out")) == rises
    assert not world.bus.level("p.out")
    assert not panel.running
    assert panel.shown == 6


def test_stopping_a_gate_lowers_it() -> None:
    world = World()
    panel = Panel(world, "p.out", FaultSet())
    panel.play(Show(MASKS, 255, 1e-3, 0.0, 0.0, 0, Out.GATE), 0.0)
    world.clock.sleep_s(1.5e-3)
    assert world.bus.level("p.out")
    panel.stop()
    assert not world.bus.level("p.out")
    world.clock.sleep_s(1.0)
    assert len(world.bus.rising("p.out")) == 1


@pytest.mark.parametrize(("fault", "rises"), [("panel.pulse_lost", 5), ("panel.pulse_twice", 7)])
def test_pulses_are_lost_and_doubled_as_told(fault: str, rises: int) -> None:
    world = World()
    faults = FaultSet()
    faults.inject(fault, skip=2)
    Panel(world, "p.out", faults).play(Show(MASKS, 255, 1e-3, 0.0, 0.0, 2, Out.MASK), 0.0)
    world.clock.sleep_s(0.1)
    assert len(world.bus.rising("p.out")) == rises
