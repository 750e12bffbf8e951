from dataclasses import replace

import pytest
import torch

from gs2ci.reconstruct.fit.density.osgr import Osgr

LARGE = 0.1


def change(scene, seen, seed=0, **rule):
    return Osgr(**rule).change(scene, seen, torch.Generator().manual_seed(seed))


def split_ones(result, count):
    """Old indices that no longer go on."""
    return sorted(set(range(count)) - set(result.source.tolist()))


def test_a_scene_at_rest_with_even_opacity_is_left_alone(line, evidence):
    result = change(line(40), evidence(40))
    assert result.source.tolist() == list(range(40))


def test_a_small_gaussian_with_a_large_gradient_is_duplicated(line, evidence):
    result = change(line(40), evidence(40, moved=(7,)))
    assert result.source.tolist() == [*range(40), -1]
    assert torch.equal(result.scene.means[40], result.scene.means[7])
    assert result.scene.opacity_logits[40] == result.scene.opacity_logits[7] < 0


def test_a_large_gaussian_with_a_large_gradient_is_split(line, evidence):
    result = change(line(40, size=LARGE), evidence(40, moved=(7,)))
    assert split_ones(result, 40) == [7]
    assert len(result.scene) == 41


def test_copies_and_children_keep_the_opacity_of_the_one_where_the_transmittance_need_not_stay(line, evidence):
    for size, moved in ((None, (7,)), (LARGE, (7,))):
        scene = line(40) if size is None else line(40, size=size)
        before = scene.opacity_logits[7]
        kept = change(scene, evidence(40, moved=moved), preserving="neither").scene.opacity_logits
        assert torch.equal(kept[-1], before)
        assert change(scene, evidence(40, moved=moved)).scene.opacity_logits[-1] < before


def test_an_opacity_that_stands_out_of_its_neighbours_is_split(line, evidence):
    opacity = torch.full((40,), 0.2)
    opacity[11] = 0.9
    result = change(line(40, opacity), evidence(40))
    assert split_ones(result, 40) == [11]


def test_an_opacity_below_its_neighbours_is_not(line, evidence):
    opacity = torch.full((40,), 0.8)
    opacity[11] = 0.1
    result = change(line(40, opacity), evidence(40))
    # Its neighbours stand out by comparison, it does not.
    assert 11 not in split_ones(result, 40)
    assert set(split_ones(result, 40)) <= {8, 9, 10, 12, 13, 14}


@pytest.mark.parametrize("share", [0.0, 0.05, 0.1])
def test_splits_by_opacity_alone_stay_within_their_budget_and_take_the_largest_excess(share, line, evidence):
    count = 200
    opacity = torch.full((count,), 0.1)
    peaks = torch.arange(5, count, 10)
    opacity[peaks] = torch.linspace(0.3, 0.9, len(peaks))
    result = change(line(count, opacity), evidence(count), extra_splits=share)
    budget = int(share * count)
    assert split_ones(result, count) == peaks[len(peaks) - budget :].tolist()


def test_a_population_too_small_for_the_budget_is_not_split_by_opacity(line, evidence):
    opacity = torch.full((19,), 0.2)
    opacity[3] = 0.9
    assert split_ones(change(line(19, opacity), evidence(19)), 19) == []


def test_those_wanted_by_gradient_do_not_use_up_the_budget_of_opacity(line, evidence):
    opacity = torch.full((40,), 0.2)
    opacity[[5, 20]] = torch.tensor([0.9, 0.8])
    result = change(line(40, opacity, size=LARGE), evidence(40, moved=(5,)), extra_splits=0.026)
    assert split_ones(result, 40) == [5, 20]


def test_ranked_first_those_wanted_by_gradient_count_in_the_budget_of_opacity(line, evidence):
    """Supplement II: of all positive deviations 5 % are retained, then merged with the conventional candidates."""
    opacity = torch.full((40,), 0.2)
    opacity[[5, 20]] = torch.tensor([0.9, 0.8])
    result = change(line(40, opacity, size=LARGE), evidence(40, moved=(5,)), extra_splits=0.026, ranked_first=True)
    assert split_ones(result, 40) == [5]


def test_a_duplicate_stays_one_however_opaque_it_is(line, evidence):
    opacity = torch.full((40,), 0.2)
    opacity[5] = 0.9
    result = change(line(40, opacity), evidence(40, moved=(5,)), extra_splits=0.026, ranked_first=True)
    assert split_ones(result, 40) == []
    assert len(result.scene) == 41


def test_near_the_cap_every_kind_of_candidate_has_its_share_of_the_room(line, evidence):
    """Twenty wanted by gradient, ten by opacity, ten by radius; room for eight: four, two, two, the first of each."""
    count = 200
    opacity = torch.full((count,), 0.2)
    peaks = torch.arange(104, 154, 5)
    opacity[peaks] = torch.linspace(0.5, 0.95, 10)
    seen = evidence(count, moved=range(60, 80), wide=range(180, 190), cap=count + 8)
    scene = line(count, opacity, size=LARGE)
    starved = split_ones(change(scene, seen, ranked_first=True), count)
    assert starved == list(range(72, 80))
    shared = split_ones(change(scene, seen, ranked_first=True, shared_room=True), count)
    assert shared == [76, 77, 78, 79, 144, 149, 188, 189]


def test_after_a_reset_the_population_rests(line, evidence):
    rule = replace(Osgr.of_the_paper(), opacity_splits=False)
    opacity = torch.full((40,), 0.5)
    opacity[3] = 0.01

    def at(iteration):
        return rule.change(line(40, opacity), evidence(40, moved=(7,), iteration=iteration), torch.Generator())

    assert at(2900).source.tolist() == [*range(3), *range(4, 40), -1]
    reset = at(3000)
    assert (reset.source.tolist(), reset.forget) == (list(range(40)), {"opacity_logits"})
    assert float(torch.sigmoid(reset.scene.opacity_logits).max()) == pytest.approx(0.2)
    assert at(3100).source.tolist() == list(range(40))
    assert at(3200).source.tolist() == [*range(3), *range(4, 40), -1]


def test_transparent_gaussians_are_removed(line, evidence):
    opacity = torch.full((40,), 0.5)
    opacity[[2, 30]] = 0.004
    result = change(line(40, opacity), evidence(40, moved=(2,)), extra_splits=0.0)
    assert split_ones(result, 40) == [2, 30]
    assert len(result.scene) == 38


def test_a_wholly_transparent_scene_is_kept_as_it_cannot_grow_again(line, evidence):
    result = change(line(40, 0.001), evidence(40))
    assert result.source.tolist() == list(range(40))


def test_the_population_never_exceeds_its_cap_and_the_largest_gradients_come_first(line, evidence):
    result = change(line(40), evidence(40, moved=range(10, 20), cap=43))
    assert len(result.scene) == 43
    copies = result.scene.means[40:, 0].tolist()
    assert sorted(copies) == [17, 18, 19]


@pytest.mark.parametrize("cap", [0, 39, 40])
def test_a_full_population_does_not_grow(cap, line, evidence):
    result = change(line(40, size=LARGE), evidence(40, moved=range(10), cap=cap))
    assert result.source.tolist() == list(range(40))


def test_removals_make_room(line, evidence):
    opacity = torch.full((40,), 0.5)
    opacity[[0, 1]] = 0.001
    result = change(line(40, opacity), evidence(40, moved=range(10, 20), cap=40), extra_splits=0.0)
    assert len(result.scene) == 40


@pytest.mark.parametrize("outstanding", [20, 21, 22, 23])
def test_points_in_one_place_are_compared_with_each_other_and_not_with_themselves(outstanding, line, evidence):
    """Eq. 13, α less the mean of α and its three neighbours', whichever of the pile a search tree lists first."""
    scene = line(60)
    scene.means[20:24] = scene.means[20]
    scene.opacity_logits[outstanding] = torch.logit(torch.tensor(0.62))
    scene.opacity_logits[40] = torch.logit(torch.tensor(0.61))
    # The one in the pile stands out by 0.09, the lone one by 0.0825: a budget of one takes the former.
    assert split_ones(change(scene, evidence(60), extra_splits=1.5 / 60), 60) == [outstanding]


@pytest.mark.parametrize("outstanding", range(20, 30, 3))
def test_in_a_pile_larger_than_the_neighbourhood_the_same_holds(outstanding, line, evidence):
    scene = line(60)
    scene.means[20:30] = scene.means[20]
    scene.opacity_logits[outstanding] = torch.logit(torch.tensor(0.62))
    scene.opacity_logits[40] = torch.logit(torch.tensor(0.61))
    assert split_ones(change(scene, evidence(60), extra_splits=1.5 / 60), 60) == [outstanding]


def test_fewer_points_than_neighbours_are_not_compared(line, evidence):
    opacity = torch.tensor([0.1, 0.9, 0.1])
    assert split_ones(change(line(3, opacity), evidence(3), extra_splits=1.0), 3) == []


def test_an_empty_scene_stays_empty(line, evidence):
    assert len(change(line(0), evidence(0)).scene) == 0


def test_the_generator_alone_decides_the_draws(line, evidence):
    scene = line(40, size=LARGE)
    seen = evidence(40, moved=range(10))
    first, again, other = (change(scene, seen, seed) for seed in (1, 1, 2))
    assert torch.equal(first.scene.means, again.scene.means)
    assert not torch.equal(first.scene.means, other.scene.means)


def test_sources_say_which_one_each_continues(line, evidence):
    opacity = torch.full((40,), 0.5)
    opacity[3] = 0.001
    result = change(line(40, opacity), evidence(40, moved=(7, 9)), extra_splits=0.0)
    going_on = result.source >= 0
    expected = line(40).colours[result.source[going_on]]
    assert torch.equal(result.scene.colours[going_on], expected)
    assert torch.equal(result.scene.colours[~going_on], line(40).colours[[7, 9]])


def test_the_sparing_rule_leaves_alone_what_is_only_wide_on_the_screen(line, evidence):
    seen = evidence(12, wide=(2, 5))
    sparing = Osgr.sparing().change(line(12), seen, torch.Generator().manual_seed(0))
    assert len(sparing.scene) == 12
    assert len(change(line(12), seen).scene) == 14
