import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut, Watch


@pytest.mark.parametrize("settings", [{"share": -0.01}, {"share": 0.51}, {"share": float("nan")}])
def test_a_share_that_makes_no_sense_is_refused(settings):
    with pytest.raises(InputError, match=r"share = .* in HoldOut"):
        HoldOut(**settings).check()


@pytest.mark.parametrize("count", ["look_every", "patience", "growth_patience"])
def test_a_count_below_one_is_refused(count):
    with pytest.raises(InputError, match=f"{count} = 0 in HoldOut"):
        HoldOut(**{count: 0}).check()


def test_the_watch_tells_each_new_best():
    watch = Watch(HoldOut())
    looks = [(50, 0.5), (100, 0.4), (150, 0.45), (200, 0.39)]
    assert [watch.note(residual, iteration) for iteration, residual in looks] == [True, True, False, True]
    assert watch.best_iteration == 200


def test_the_watch_stalls_after_its_patience_without_improvement():
    watch = Watch(HoldOut(patience=150))
    watch.note(0.5, 50)
    for iteration, stalled in ((100, False), (150, False), (200, True)):
        watch.note(0.6, iteration)
        assert watch.stalled(iteration) is stalled


def test_an_improvement_too_small_to_count_is_remembered_and_still_stalls():
    watch = Watch(HoldOut(patience=100, improvement=1e-2))
    watch.note(0.5, 50)
    assert watch.note(0.499, 100)
    assert watch.note(0.498, 150)
    assert watch.stalled(150)
    assert watch.best_iteration == 150


def test_small_improvements_add_up():
    watch = Watch(HoldOut(patience=100, improvement=1e-2))
    for iteration, residual in ((50, 0.5), (100, 0.497), (150, 0.494)):
        watch.note(residual, iteration)
    assert not watch.stalled(200)


def test_the_population_grows_only_while_the_residual_improves():
    watch = Watch(HoldOut(growth_patience=50))
    watch.note(0.5, 50)
    assert watch.may_grow(50)
    assert watch.may_grow(100)
    watch.note(0.6, 100)
    assert not watch.may_grow(150)
    watch.note(0.4, 150)
    assert watch.may_grow(150)


def test_after_a_set_back_recovery_counts_as_improvement_and_the_best_state_stays_the_best():
    watch = Watch(HoldOut(patience=100, growth_patience=50))
    watch.note(0.5, 50)
    watch.set_back(100)
    assert not watch.note(0.9, 150)
    assert not watch.note(0.7, 200)
    assert watch.may_grow(200)
    assert not watch.stalled(200)
    assert not watch.note(0.7, 300)
    assert watch.stalled(300)
    assert watch.best_iteration == 50


def test_a_new_beginning_forgets_the_best_state_too():
    watch = Watch(HoldOut(patience=100, growth_patience=50))
    watch.note(0.5, 50)
    watch.begin_again(100)
    assert watch.note(0.9, 150)
    assert watch.best_iteration == 150
    assert not watch.note(0.95, 200)


def test_a_residual_that_has_risen_for_as_long_as_patience_lasts_will_not_fall_again():
    watch = Watch(HoldOut(patience=100))
    looks = [(50, 0.5), (100, 0.6), (150, 0.51), (200, 0.53), (250, 0.49), (300, 0.6)]
    risen = []
    for iteration, residual in looks:
        watch.note(residual, iteration)
        risen.append(watch.has_risen(iteration))
    assert risen == [False, False, False, True, False, False]
    watch.begin_again(350)
    assert watch.note(0.6, 350)
    assert watch.has_risen(350)
    watch.set_back(400)
    watch.note(0.9, 500)
    assert not watch.has_risen(500)


def test_patience_lasts_for_as_many_looks_whatever_lies_between_them():
    few, many = HoldOut(share=0.1).looking(10), HoldOut().looking(50)
    assert (few.look_every, few.patience, few.growth_patience, few.share) == (10, 30, 10, 0.1)
    assert (many.look_every, many.patience, many.growth_patience) == (50, 150, 50)


def test_without_held_out_pixels_every_look_is_the_best_and_nothing_stalls():
    watch = Watch(HoldOut(patience=50, growth_patience=50))
    for iteration in range(50, 500, 50):
        assert watch.note(None, iteration)
        assert not watch.stalled(iteration)
        assert watch.may_grow(iteration)


def test_an_infinite_residual_is_never_the_best():
    watch = Watch(HoldOut(patience=100))
    assert not watch.note(float("inf"), 50)
    assert not watch.note(float("inf"), 100)
    assert watch.stalled(100)
    assert watch.best_iteration == 0
