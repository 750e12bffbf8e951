import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.clock import Clock
from gs2ci.core.errors import InputError
from gs2ci_sims.world import Mount, VirtualClock, World


class Recording:
    def collect(self, exposure):
        return np.zeros((exposure.height, exposure.width), np.uint16)


def test_time_passes_only_by_waiting_and_events_happen_in_order():
    clock: Clock = VirtualClock(0.0)
    happened = []
    clock.after(2.0, lambda: happened.append(("b", clock.now_s())))
    clock.after(1.0, lambda: happened.append(("a", clock.now_s())))
    clock.after(1.0, lambda: happened.append(("a2", clock.now_s())))
    assert clock.now_s() == 0.0
    clock.sleep_s(1.5)
    assert happened == [("a", 1.0), ("a2", 1.0)]
    clock.sleep_s(-5.0)
    assert clock.now_s() == 1.5
    clock.sleep_s(1.0)
    assert happened[-1] == ("b", 2.0)
    assert clock.now_s() == 2.5


def test_waiting_for_something_ends_when_it_happens_or_at_the_deadline():
    clock = VirtualClock(0.0)
    seen = []
    clock.after(0.3, lambda: seen.append(1))
    assert clock.wait_until(lambda: bool(seen), 1.0)
    assert clock.now_s() == 0.3
    assert not clock.wait_until(lambda: len(seen) > 1, 1.0)
    assert clock.now_s() == 1.3


def test_a_cancelled_event_does_not_happen():
    clock = VirtualClock(0.0)
    event = clock.after(0.1, lambda: pytest.fail("cancelled"))
    event.cancel()
    event.cancel()
    clock.sleep_s(1.0)


def test_firmware_that_waits_on_the_world_is_a_mistake():
    clock = VirtualClock(0.0)
    clock.after(0.1, lambda: clock.sleep_s(1.0))
    with pytest.raises(RuntimeError, match="scheduled action waited"):
        clock.sleep_s(1.0)


def test_events_scheduled_by_events_happen_in_the_same_wait():
    clock = VirtualClock(0.0)
    seen = []
    clock.after(0.1, lambda: clock.after(0.1, lambda: seen.append(clock.now_s())))
    clock.sleep_s(1.0)
    assert seen == [pytest.approx(0.2)]


@given(st.lists(st.floats(0, 10), max_size=30))
def test_time_never_goes_back(delays):
    clock = VirtualClock(0.0)
    times = []
    for delay in delays:
        clock.after(delay, lambda: times.append(clock.now_s()))
    clock.sleep_s(11.0)
    assert times == sorted(times)
    assert len(times) == len(delays)


def test_trigger_lines_tell_their_changes_and_only_those():
    world = World(Recording())
    heard = []
    world.bus.listen("out", lambda edge: heard.append((edge.level, edge.when_s)))
    world.bus.drive("out", False)
    world.bus.pulse("out", 20e-6)
    world.bus.drive("out", True)
    world.clock.sleep_s(1.0)
    assert [level for level, _ in heard] == [True, False]
    assert heard[1][1] - heard[0][1] == pytest.approx(20e-6)
    assert world.bus.rising("out") == [heard[0][1]]
    assert not world.bus.level("out")


def test_masks_are_cut_to_the_exposure_and_dark_is_left_out():
    world = World(Recording())
    start_s = world.clock.now_s()
    first, second = np.ones((2, 2), np.uint8), np.zeros((2, 2), np.uint8)
    world.show_mask(first)
    world.clock.sleep_s(1.0)
    world.show_mask(None)
    world.clock.sleep_s(0.5)
    world.show_mask(second, top=255)
    world.clock.sleep_s(1.0)
    masks = world.masks_between(start_s + 0.25, start_s + 2.0)
    assert [(mask.start_s - start_s, mask.end_s - start_s, mask.top) for mask in masks] == [
        (0.25, 1.0, 1),
        (1.5, 2.0, 255),
    ]
    assert masks[0].levels is first
    assert world.masks_between(start_s + 1.1, start_s + 1.2) == ()
    assert world.masks_between(start_s - 5.0, start_s) == ()


def test_what_is_shown_and_replaced_at_the_same_moment_was_never_on_show():
    world = World(Recording())
    start_s = world.clock.now_s()
    world.show_mask(np.ones((1, 1), np.uint8))
    world.show_mask(None)
    world.clock.sleep_s(1.0)
    assert world.masks_between(start_s, start_s + 1.0) == ()


def test_moving_the_stage_moves_the_camera_and_the_scene_the_other_way():
    rest = np.eye(4)
    rest[:3, 3] = (0.0, 0.0, 2.0)
    world = World(Recording(), Mount(rest, {"x": (0.1, 0.0, 0.0)}, {"x": 50.0}))

    class Carriage:
        def positions_mm_at(self, when_s):
            return {"x": 50.0 + when_s, "unused": 3.0}

    assert np.array_equal(world.world_to_camera_at(0.0), rest)
    world.carry_camera(Carriage())
    pose = world.world_to_camera_at(10.0)
    assert pose[:3, 3] == pytest.approx((-1.0, 0.0, 2.0))


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.0), (1.0, 0.5), (0.0, 5.0)])
def test_an_exposure_without_length_or_in_the_future_is_refused(begin, end):
    world = World(Recording())
    start_s = world.clock.now_s()
    world.clock.sleep_s(1.0)
    with pytest.raises(InputError, match="ends by now"):
        world.integrate(start_s + begin, start_s + end, height=2, width=2, bits=8)


def test_exposures_are_numbered_and_remembered():
    world = World(Recording())
    start_s = world.clock.now_s()
    world.clock.sleep_s(1.0)
    for _ in range(2):
        world.integrate(start_s, start_s + 0.5, height=2, width=3, bits=8)
    assert [exposure.index for exposure in world.exposures] == [0, 1]


def test_a_mask_that_is_no_picture_is_refused():
    with pytest.raises(InputError, match="top >= 1"):
        World(Recording()).show_mask(np.ones((2, 2, 2), np.uint8))
