"""A machine whose speed is whatever the test wants, and the schedule that keeps to its deadline on it."""

import pytest

from gs2ci.reconstruct.fit.coarse.pace import LOOKS_AFTERWARDS, Deadline, Pace

EXPECTED_ITERATION_S = 0.1
EXPECTED_LOOK_S = 0.2
LOOK_EVERY = 50


class Machine:
    """Takes `slowness(seconds so far)` times as long as expected for everything, on its own clock."""

    def __init__(self, slowness):
        self.now_s = 1000.0
        self._began_s = self.now_s
        self._slowness = slowness

    def clock(self):
        return self.now_s

    def work(self, expected_s):
        took_s = expected_s * self._slowness(self.now_s - self._began_s)
        self.now_s += took_s
        return took_s

    def fit(self, deadline, cost=lambda share: EXPECTED_ITERATION_S, stall_at=None):
        """Go through a fit as the loop does; return its iterations and the totals that it was told."""
        done, totals = 0, [deadline.total(0)]
        while done < totals[-1]:
            self.work(cost(done / totals[-1]))
            done += 1
            totals.append(deadline.total(done))
            if done % LOOK_EVERY == 0 or done >= totals[-1]:
                deadline.looked(self.work(EXPECTED_LOOK_S))
            if done == stall_at:
                break
        return done, totals

    def hand_over(self):
        self.work(LOOKS_AFTERWARDS * EXPECTED_LOOK_S)


def deadline(machine, seconds, most=100_000, costs=lambda share: EXPECTED_ITERATION_S):
    return Deadline(most, machine.now_s + seconds, costs, EXPECTED_LOOK_S, LOOK_EVERY, machine.clock)


def test_a_fixed_pace_is_the_number_whatever_the_time():
    pace = Pace(70)
    pace.looked(1e9)
    assert [pace.total(done) for done in (0, 30, 70)] == [70] * 3
    assert not pace.is_late(70)


@pytest.mark.parametrize(
    "slowness",
    [
        lambda s: 1.0,
        lambda s: 0.3,
        lambda s: 4.0,
        lambda s: 1.0 if s < 30 else 3.0,
        lambda s: 3.0 if s < 30 else 0.7,
        lambda s: 1.0 + s / 20,
        lambda s: 1.0 if int(s) % 2 else 3.0,
    ],
    ids=["as expected", "three times as fast", "four times as slow", "slows down", "speeds up", "wades", "flickers"],
)
def test_the_fit_and_what_follows_end_in_time_and_use_it_whatever_the_machines_speed(slowness):
    machine = Machine(slowness)
    pace = deadline(machine, 60.0)
    done, _ = machine.fit(pace)
    machine.hand_over()
    assert 0.94 * 60 < machine.now_s - 1000 < 1.02 * 60
    assert pace.is_late(done)


def test_costs_that_grow_with_the_share_of_the_schedule_are_foreseen():
    def cost(share):
        return EXPECTED_ITERATION_S * (1 + 4 * share)

    machine = Machine(lambda s: 1.5)
    done, totals = machine.fit(deadline(machine, 60.0, costs=cost), cost)
    machine.hand_over()
    assert 0.94 * 60 < machine.now_s - 1000 < 1.02 * 60
    # After the first tenth the speed is known: the schedule's length hardly changes any more.
    assert max(abs(total - done) for total in totals[done // 10 :]) <= 0.1 * done


def test_never_more_iterations_than_there_is_use_for():
    machine = Machine(lambda s: 0.01)
    pace = deadline(machine, 60.0, most=300)
    done, totals = machine.fit(pace)
    assert done == 300
    assert max(totals) == 300
    assert not pace.is_late(done)
    assert machine.now_s - 1000 < 60


def test_a_deadline_that_has_passed_still_gives_one_iteration():
    machine = Machine(lambda s: 1.0)
    done, _ = machine.fit(deadline(machine, -5.0))
    assert done == 1


def test_a_machine_that_stops_for_a_while_ends_the_fit_at_once_afterwards():
    machine = Machine(lambda s: 500.0 if 10 < s < 11 else 1.0)
    done, _ = machine.fit(deadline(machine, 40.0))
    assert machine.now_s - 1000 < 10 + 2 + 500 * EXPECTED_LOOK_S + 1
    assert done < 400


def test_a_clock_that_stands_still_does_not_divide_by_zero():
    pace = Deadline(50, 10.0, lambda share: 0.0, 0.0, LOOK_EVERY, lambda: 0.0)
    assert [pace.total(done) for done in (0, 10, 50)] == [50] * 3


def test_fits_beside_each_other_end_by_the_same_deadline_whatever_the_speed_of_each():
    machine, slow = Machine(lambda s: 1.0), Machine(lambda s: 2.5)
    leader = deadline(machine, 60)
    companion = leader.beside()
    companion._clock = slow.clock
    done, _ = machine.fit(leader)
    done_slowly, _ = slow.fit(companion)
    for each in (machine, slow):
        each.hand_over()
        assert 0.9 * 60 <= each.now_s - 1000 <= 60 * 1.02
    assert done_slowly < 0.5 * done


def test_a_fixed_pace_beside_another_is_the_same():
    pace = Pace(7)
    assert pace.beside() is pace
