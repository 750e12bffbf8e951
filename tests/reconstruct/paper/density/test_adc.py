import torch

from gs2ci.reconstruct.paper.density.rules import adc

LARGE = 0.1


def change(scene, seen, seed=0):
    return adc().change(scene, seen, torch.Generator().manual_seed(seed))


def test_a_scene_at_rest_is_left_alone_however_its_opacities_stand_out(line, evidence):
    opacity = torch.full((40,), 0.1)
    opacity[::7] = 0.99
    result = change(line(40, opacity), evidence(40))
    assert result.source.tolist() == list(range(40))
    assert result.forget == frozenset()


def test_copies_and_children_keep_the_opacity_of_the_one_they_come_from(line, evidence):
    scene = line(40, 0.6)
    scene.log_scales[9] = torch.tensor(LARGE).log()
    result = change(scene, evidence(40, moved=(7, 9)))
    assert result.source.tolist() == [*range(9), *range(10, 40), -1, -1, -1]
    assert torch.equal(result.scene.opacity_logits, scene.opacity_logits[:1].expand(42))


def test_the_population_never_exceeds_its_cap_and_the_largest_gradients_come_first(line, evidence):
    result = change(line(40), evidence(40, moved=range(10, 20), cap=43))
    assert sorted(result.scene.means[40:, 0].tolist()) == [17.0, 18.0, 19.0]


def test_the_faint_are_removed_and_not_copied(line, evidence):
    opacity = torch.full((40,), 0.5)
    opacity[7] = 0.004
    result = change(line(40, opacity), evidence(40, moved=(7,)))
    assert result.source.tolist() == [i for i in range(40) if i != 7]


def test_every_so_many_iterations_opacities_are_reset_newcomers_included(line, evidence):
    result = change(line(40, 0.9), evidence(40, moved=(7,), iteration=3000))
    assert len(result.scene) == 41
    torch.testing.assert_close(torch.sigmoid(result.scene.opacity_logits), torch.full((41,), 0.01))
    assert result.forget == {"opacity_logits"}


def test_nothing_is_shaken(line):
    assert adc().shake(line(4), 1.0, torch.Generator()) is None
