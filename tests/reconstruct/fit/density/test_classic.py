"""The criteria that adc, revised and osgr share."""

import pytest
import torch

from gs2ci.reconstruct.fit.density.base import PopulationChange
from gs2ci.reconstruct.fit.density.classic import Classic

LARGE, HUGE = 0.1, 3.0


def indices(mask):
    return torch.nonzero(mask).flatten().tolist()


def divided(scene, seen, criteria=None):
    criteria = criteria or Classic()
    split, duplicate = criteria.divide(scene, seen, criteria.wanting(seen))
    return indices(split), indices(duplicate)


def test_size_decides_between_split_and_duplicate(line, evidence):
    scene = line(6)
    scene.log_scales[3:] = torch.tensor([LARGE, 0.001, 0.001]).log()  # along one axis only
    assert divided(scene, evidence(6, moved=(1, 4))) == ([4], [1])


def test_the_threshold_itself_is_not_enough(line, evidence):
    seen = evidence(6)
    seen.screen_gradient[2] = Classic().gradient
    assert divided(line(6), seen) == ([], [])
    seen.screen_gradient[2] *= 1.001
    assert divided(line(6), seen) == ([], [2])


def test_a_wide_one_on_the_screen_is_split_whatever_its_gradient_and_not_duplicated_as_well(line, evidence):
    assert divided(line(6), evidence(6, moved=(1, 2), wide=(2, 5))) == ([2, 5], [1])


def test_widths_on_the_screen_no_longer_count_late_in_the_schedule(line, evidence):
    late = evidence(6, moved=(1, 2), wide=(2, 5), iteration=Classic().screen_until)
    assert divided(line(6), late) == ([], [1, 2])


def test_sizes_remove_nothing_before_the_first_reset(line, evidence):
    scene = line(4, size=HUGE)
    criteria = Classic()
    before = evidence(4, wide=(1,), iteration=criteria.reset_every)
    assert indices(criteria.removed(scene, before)) == []
    scene.log_scales[2] = -5.0
    after = evidence(4, iteration=criteria.reset_every + 1)
    assert indices(criteria.removed(scene, after)) == [0, 1, 3]


def test_widths_remove_after_the_first_reset_until_they_no_longer_count(line, evidence):
    criteria = Classic()
    soon = evidence(4, wide=(1,), iteration=criteria.reset_every + 1)
    assert indices(criteria.removed(line(4), soon)) == [1]
    late = evidence(4, wide=(1,), iteration=criteria.screen_until)
    assert indices(criteria.removed(line(4), late)) == []


def test_all_of_a_scene_is_never_removed(line, evidence):
    criteria = Classic()
    assert indices(criteria.removed(line(4, 0.001), evidence(4))) == []
    assert indices(criteria.removed(line(4, size=HUGE), evidence(4, iteration=criteria.reset_every + 1))) == []


@pytest.mark.parametrize(
    ("every", "iteration", "due"), [(3000, 3000, True), (3000, 6000, True), (3000, 2900, False), (3000, 0, False)]
)
def test_a_reset_bounds_all_opacities_and_lets_the_optimiser_forget(line, every, iteration, due, evidence):
    opacity = torch.tensor([0.9, 0.002, 0.01, 1 - 1e-6])
    change = PopulationChange(line(4, opacity), torch.arange(4))
    criteria = Classic(reset_every=every)
    result = criteria.reset(change, evidence(4, iteration=iteration))
    expected = opacity.clamp(max=criteria.reset_to) if due else opacity
    torch.testing.assert_close(torch.sigmoid(result.scene.opacity_logits), expected, rtol=1e-5, atol=1e-7)
    assert result.forget == (frozenset({"opacity_logits"}) if due else frozenset())
    torch.testing.assert_close(torch.sigmoid(change.scene.opacity_logits), opacity, rtol=1e-5, atol=1e-7)


def test_without_resets_there_are_none(line, evidence):
    change = PopulationChange(line(4, 0.9), torch.arange(4))
    assert Classic(reset_every=None).reset(change, evidence(4, iteration=3000)) is change


def test_what_a_reset_leaves_is_not_removed_at_once(line, evidence):
    """The bound is above the removal's: what is needed has time to recover."""
    criteria = Classic()
    change = criteria.reset(PopulationChange(line(4, 0.9), torch.arange(4)), evidence(4, iteration=3000))
    assert indices(criteria.removed(change.scene, evidence(4, iteration=3100))) == []


def test_no_limit_on_radii_leaves_the_wide_alone(line, evidence):
    seen = evidence(6, moved=(1,), wide=(2, 5))
    assert divided(line(6), seen, Classic(large_on_screen=None)) == ([], [1])
