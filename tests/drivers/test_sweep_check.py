import numpy as np
import pytest

from gs2ci_drivers.axis import AxisInfo, plan_sweep
from gs2ci_drivers.failures import PathError
from gs2ci_drivers.sweep_check import MOST_POSITIONS, SweepCheck
from gs2ci_sims.axis_motion import AxisMotion
from gs2ci_sims.world import VirtualClock

AXIS = AxisInfo("x", 0.0, 100.0, 0.001, 40.0, 0.001, 200.0)
SWEEP = plan_sweep("stage0", AXIS, 40.0, 44.0, 10.0)


def read(motion, begun_s, *, until_s=0.5, every_s=0.01, takes_s=0.006, share=0.3):
    """Ask a moving axis; each answer was true at a share of its exchange."""
    check = SweepCheck("stage0", AXIS, SWEEP, begun_s + SWEEP.lead_s)
    for asked_s in np.arange(begun_s + 0.02, begun_s + until_s, every_s):
        at_mm = AXIS.quantise_mm(motion.position_at(asked_s + share * takes_s))
        check.read.append((asked_s, asked_s + takes_s, at_mm))
    return check


def moved(begun_s=5.0, factor=1.0, sweep=SWEEP):
    motion = AxisMotion(sweep.begin_mm, AXIS.acceleration_mm_s2)
    motion.move_to(sweep.end_mm, sweep.speed_mm_s * factor, begun_s)
    return motion


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5, 1.0])
def test_positions_of_a_sound_sweep_allow_it_wherever_in_their_exchange_they_were_true(share):
    path = read(moved(), 5.0, share=share).path()
    assert path.speed_factor == 1.0
    assert abs(path.shift_s) <= 0.0031
    assert path.error_mm == pytest.approx(0.001 + 10.0 * 0.003)
    assert path.position_mm(5.0 + SWEEP.lead_s + 0.2) == pytest.approx(42.0, abs=path.error_mm)


def test_a_late_start_is_measured_and_a_pose_in_its_ramp_is_counted():
    motion = moved(5.08)
    check = SweepCheck("stage0", AXIS, SWEEP, 5.0 + SWEEP.lead_s, read(motion, 5.0).read)
    path = check.path()
    assert path.shift_s == pytest.approx(0.08, abs=0.0031)
    first_s = 5.0 + SWEEP.lead_s
    assert path.outside_s(first_s, first_s + 0.1) == pytest.approx(path.shift_s)
    assert path.outside_s(first_s + 0.1, first_s + SWEEP.cruise_s) == 0.0
    assert path.outside_s(first_s + 0.1, first_s + SWEEP.cruise_s + 0.2) == pytest.approx(0.2 - path.shift_s)


@pytest.mark.parametrize("factor", [0.994, 1.006])
def test_another_crystal_is_stated_and_poses_keep_the_planned_speed_from_the_beginning(factor):
    sweep = plan_sweep("stage0", AXIS, 10.0, 90.0, 10.0)
    motion = moved(factor=factor, sweep=sweep)
    check = SweepCheck("stage0", AXIS, sweep, 5.0 + sweep.lead_s)
    for asked_s in np.arange(5.1, 12.0, 0.02):
        check.read.append((asked_s, asked_s + 0.006, motion.position_at(asked_s + 0.003)))
    path = check.path()
    assert path.speed_factor == pytest.approx(factor, abs=1e-3)
    first_s = path.crossed_s + path.shift_s
    assert path.position_mm(first_s) == pytest.approx(motion.position_at(first_s), abs=2 * path.error_mm)
    assert path.position_mm(first_s + 1.0) - path.position_mm(first_s) == pytest.approx(sweep.speed_mm_s)


def test_a_speed_that_no_crystal_explains_is_refused():
    with pytest.raises(PathError, match=r"axis x left its path by 0\.\d+ mm or more.*retries = 1"):
        read(moved(factor=0.8), 5.0).path()


@pytest.mark.parametrize("how", [{"pause_s": 0.03}, {"speed_factor": 0.7}, {"speed_factor": 1.4}, {"jump_mm": 0.2}])
@pytest.mark.parametrize("at_s", [0.1, 0.25, 0.35])
def test_what_happens_on_the_way_is_refused(how, at_s):
    motion = moved()
    motion.disturb(5.0 + at_s, **how)
    with pytest.raises(PathError, match="left its path"):
        read(motion, 5.0).path()


def test_nothing_that_was_read_leaves_the_plan_as_it_is():
    path = SweepCheck("stage0", AXIS, SWEEP, 5.0).path()
    assert (path.shift_s, path.speed_factor, path.positions) == (0.0, 1.0, 0)
    assert path.error_mm == AXIS.error_mm


def test_rest_before_and_after_the_sweep_says_when_it_cannot_have_been():
    check = SweepCheck("stage0", AXIS, SWEEP, 5.0)
    check.read.append((5.0, 5.006, SWEEP.begin_mm))  # at rest, when it should have crossed
    assert check.path().shift_s > 0.03
    check.read.append((5.3, 5.306, SWEEP.end_mm))
    with pytest.raises(PathError):
        check.path()


def test_long_sweeps_are_read_less_often_than_the_line_allows():
    clock = VirtualClock()

    class Standing:
        sample_gap_s = 0.0

        def position_mm(self, axis):
            clock.sleep_s(1e-3)
            return 40.0

    sweep = plan_sweep("stage0", AXIS, 10.0, 90.0, 4.0)
    check = SweepCheck("stage0", AXIS, sweep, clock.now_s())
    check.ask_until(clock.now_s() + sweep.cruise_s, Standing(), clock)
    assert len(check.read) == pytest.approx(MOST_POSITIONS, abs=2)
