import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gs2ci.core.mechanics import Mechanics
from gs2ci_drivers.axis import trapezoid_time_s
from gs2ci_sims.axis_motion import AxisMotion

COORDINATES = st.floats(-100, 100)


@given(COORDINATES, COORDINATES, st.floats(0.1, 50), st.floats(1, 500))
def test_a_move_ends_at_rest_on_its_target_after_the_time_of_a_trapezoid(start, target, speed, acceleration):
    axis = AxisMotion(start, acceleration)
    ends_s = axis.move_to(target, speed, 10.0)
    assert ends_s - 10.0 == pytest.approx(trapezoid_time_s(target - start, speed, acceleration), abs=1e-6)
    assert axis.position_at(ends_s) == pytest.approx(target, abs=1e-6)
    assert axis.speed_at(ends_s) == pytest.approx(0.0, abs=1e-6)
    assert axis.position_at(9.0) == start
    assert axis.position_at(ends_s + 100) == axis.position_at(ends_s)


@given(COORDINATES, COORDINATES, st.floats(0.0, 1.0), st.floats(0.5, 20), st.floats(0.5, 20))
def test_a_newer_target_is_reached_from_any_motion(first, second, share, speed, other_speed):
    axis = AxisMotion(0.0, 40.0)
    ends_s = axis.move_to(first, speed, 0.0)
    again_s = axis.move_to(second, other_speed, share * ends_s)
    assert axis.position_at(again_s) == pytest.approx(second, abs=1e-6)
    assert axis.speed_at(again_s) == pytest.approx(0.0, abs=1e-6)


@given(st.lists(st.tuples(COORDINATES, st.floats(0.5, 20), st.floats(0, 5)), min_size=1, max_size=6))
def test_position_and_speed_never_jump(moves):
    axis = AxisMotion(0.0, 40.0)
    now_s = 0.0
    for target, speed, pause_s in moves:
        axis.move_to(target, speed, now_s)
        now_s += pause_s
    times = np.linspace(-1.0, now_s + 1.0, 400)
    positions = np.array([axis.position_at(t) for t in times])
    speeds = np.array([axis.speed_at(t) for t in times])
    step_s = times[1] - times[0]
    assert np.abs(np.diff(positions)).max() <= np.abs(speeds).max() * step_s + 20 * step_s**2 + 1e-6
    assert np.abs(np.diff(speeds)).max() <= 40.0 * step_s * 1.01 + 1e-9


def test_braking_takes_its_time_and_halting_none():
    axis = AxisMotion(0.0, 10.0)
    axis.move_to(100.0, 5.0, 0.0)
    assert axis.stop(2.0) == pytest.approx(2.5)
    other = AxisMotion(0.0, 10.0)
    other.move_to(100.0, 5.0, 0.0)
    here = other.position_at(2.0)
    other.halt(2.0)
    assert other.position_at(50.0) == pytest.approx(here)
    assert not other.moving_at(2.0)


def test_a_given_speed_is_kept_until_told_otherwise():
    axis = AxisMotion(0.0, 10.0)
    ramp_ends_s = axis.move_at(-5.0, 0.0)
    assert axis.moving_at(1000.0)
    assert axis.position_at(ramp_ends_s + 10) - axis.position_at(ramp_ends_s) == pytest.approx(-50.0)


def test_renaming_the_position_keeps_the_history():
    axis = AxisMotion(5.0, 10.0)
    axis.set_position(0.0, 1.0)
    assert (axis.position_at(0.5), axis.position_at(2.0)) == (5.0, 0.0)


def test_perfect_mechanics_are_the_identity():
    axis = AxisMotion(0.0, 10.0)
    axis.move_to(20.0, 5.0, 0.0)
    for t in np.linspace(0, 6, 50):
        assert axis.true_position_at(t) == axis.position_at(t)


def test_scale_sign_lag_and_ripple_do_what_they_say():
    def at(t, mechanics):
        axis = AxisMotion(0.0, 1e6, mechanics)
        axis.move_to(100.0, 10.0, 0.0)
        return axis.true_position_at(t)

    assert at(5.0, Mechanics(scale=1.01)) == pytest.approx(50.5, rel=1e-4)
    assert at(5.0, Mechanics(reversed_sign=True)) == pytest.approx(-50.0, rel=1e-4)
    assert at(5.0, Mechanics(lag_s=0.1)) == pytest.approx(49.0, rel=1e-4)
    assert at(5.025, Mechanics(ripple_mm=0.01, pitch_mm=1.0)) == pytest.approx(50.26, rel=1e-4)


def test_backlash_is_lost_at_every_reversal_and_only_there():
    axis = AxisMotion(0.0, 100.0, Mechanics(backlash_mm=0.05))
    t = axis.move_to(10.0, 5.0, 0.0)
    assert axis.true_position_at(t) == pytest.approx(9.95)
    t = axis.move_to(20.0, 5.0, t)
    assert axis.true_position_at(t) == pytest.approx(19.95)
    t = axis.move_to(10.0, 5.0, t)
    assert axis.true_position_at(t) == pytest.approx(10.0)
    t = axis.move_to(10.02, 5.0, t)
    assert axis.true_position_at(t) == pytest.approx(10.0)


def test_a_newer_move_goes_at_its_own_speed():
    axis = AxisMotion(0.0, 10.0)
    axis.move_to(100.0, 10.0, 0.0)
    ends_s = axis.move_to(
        100.0, 2.0, 2.0
    )  # from 15 mm at 10 mm/s: 0.8 s and 4.8 mm to 2 mm/s, 0.2 s and 0.2 mm to rest
    assert axis.speed_at(10.0) == pytest.approx(2.0)
    assert ends_s == pytest.approx(2.0 + 0.8 + 80.0 / 2.0 + 0.2)
    assert axis.position_at(ends_s) == pytest.approx(100.0)


def test_the_play_is_left_where_a_given_speed_turns_round():
    """The play operator, followed in small steps."""
    axis = AxisMotion(0.0, 10.0, Mechanics(backlash_mm=0.5))
    axis.move_at(5.0, 0.0)
    axis.move_at(-5.0, 2.0)
    behind, before = 0.0, 0.0
    for t in np.linspace(0, 6, 6001):
        counted = axis.position_at(t)
        behind, before = min(max(behind + counted - before, 0.0), 0.5), counted
        assert axis.true_position_at(t) == pytest.approx(counted - behind, abs=1e-5)


def ends_of(mechanics, targets=(10.0, 0.0) * 20):
    axis, now_s, ends = AxisMotion(0.0, 100.0, mechanics), 0.0, []
    for target in targets:
        now_s = axis.move_to(target, 10.0, now_s) + 1.0
        assert axis.position_at(now_s) == pytest.approx(target, abs=1e-9)
        ends.append(axis.true_position_at(now_s))
    return np.array(ends)


def test_an_axis_that_repeats_badly_scatters_about_its_targets_and_forgets():
    ends = ends_of(Mechanics(repeatability_mm=0.02, seed=1))
    off = ends - np.tile([10.0, 0.0], 20)
    assert off.std() == pytest.approx(0.02, rel=0.4)
    assert abs(off[20:].mean()) < 0.02
    assert np.array_equal(ends, ends_of(Mechanics(repeatability_mm=0.02, seed=1)))
    assert not np.array_equal(ends, ends_of(Mechanics(repeatability_mm=0.02, seed=2)))


def test_a_slipping_coupling_loses_some_of_every_move_for_good():
    ends = ends_of(Mechanics(slip_mm=0.1), targets=tuple(np.arange(1.0, 41.0)))
    lost = np.arange(1.0, 41.0) - ends
    assert (np.diff(lost) >= 0).all()
    assert lost[-1] == pytest.approx(40 * 0.05, rel=0.3)


def test_an_axis_at_a_wrong_speed_arrives_early_or_late():
    for error in (-0.1, 0.1):
        axis = AxisMotion(0.0, 1e6, Mechanics(speed_error=error))
        assert axis.move_to(10.0, 1.0, 0.0) == pytest.approx(10.0 / (1 + error), rel=1e-3)
        assert axis.speed_at(5.0) == pytest.approx(1 + error)
        axis.move_at(1.0, 20.0)
        assert axis.speed_at(21.0) == pytest.approx(1 + error)
