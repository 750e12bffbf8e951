import math

import pytest
import torch

from gs2ci.reconstruct.fit.density.base import SPLIT_SHRINK, change_among, grow
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.paper.density.mcmc import Mcmc
from gs2ci.reconstruct.paper.density.revised import Revised
from gs2ci.render.gaussians import Gaussians, rotation_matrices

LOGITS = (-20.0, -6.0, -1.0, 0.0, 1.0, 6.0, 20.0)


def scene_of(logits, seed=0):
    draw = torch.Generator().manual_seed(seed)
    count = len(logits)
    return Gaussians(
        means=torch.randn(count, 3, generator=draw),
        log_scales=torch.randn(count, 3, generator=draw) - 3,
        quaternions=torch.randn(count, 4, generator=draw),
        opacity_logits=torch.tensor(logits),
        colours=torch.rand(count, 3, generator=draw),
    )


def chosen(count, *indices):
    mask = torch.zeros(count, dtype=torch.bool)
    mask[list(indices)] = True
    return mask


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def log_transmittance(logits):
    """ln(1 − sigmoid(x)) in float64."""
    return -torch.nn.functional.softplus(logits.double(), threshold=float("inf"))


def test_nothing_chosen_changes_nothing():
    scene = scene_of(LOGITS)
    change = grow(scene, torch.ones(7, dtype=torch.bool), chosen(7), chosen(7), generator())
    assert change.source.tolist() == list(range(7))
    for name, tensor in change.scene.parameters().items():
        assert torch.equal(tensor, scene.parameters()[name])


@pytest.mark.parametrize("logit", LOGITS)
def test_a_duplicate_and_its_original_let_through_what_one_did(logit):
    scene = scene_of((0.3, logit))
    change = grow(scene, chosen(2, 0, 1), chosen(2, 1), chosen(2), generator())
    assert change.source.tolist() == [0, 1, -1]
    assert change.scene.opacity_logits[0] == scene.opacity_logits[0]
    both = log_transmittance(change.scene.opacity_logits[1:]).sum()
    torch.testing.assert_close(both, log_transmittance(scene.opacity_logits[1]), rtol=1e-6, atol=0)
    for name in ("means", "log_scales", "quaternions", "colours"):
        original, copy = change.scene.parameters()[name][1:]
        assert torch.equal(original, copy)
        assert torch.equal(original, scene.parameters()[name][1])


@pytest.mark.parametrize("logit", LOGITS)
def test_the_children_of_a_split_let_through_what_their_parent_did(logit):
    scene = scene_of((0.3, logit))
    change = grow(scene, chosen(2, 0), chosen(2), chosen(2, 1), generator())
    assert change.source.tolist() == [0, -1, -1]
    both = log_transmittance(change.scene.opacity_logits[1:]).sum()
    torch.testing.assert_close(both, log_transmittance(scene.opacity_logits[1]), rtol=1e-6, atol=0)
    for child in (1, 2):
        expected = scene.log_scales[1] - math.log(SPLIT_SHRINK)
        torch.testing.assert_close(change.scene.log_scales[child], expected)
        assert torch.equal(change.scene.quaternions[child], scene.quaternions[1])
        assert torch.equal(change.scene.colours[child], scene.colours[1])


def test_children_are_drawn_from_their_parents_own_density():
    scene = scene_of((0.0,)).map(lambda tensor: tensor.repeat(4000, *(1,) * (tensor.dim() - 1)))
    change = grow(scene, chosen(4000), chosen(4000), torch.ones(4000, dtype=torch.bool), generator())
    rotation = rotation_matrices(scene.quaternions[:1])[0].double()
    along_axes = (change.scene.means - scene.means[0]).double() @ rotation
    spread = along_axes.std(dim=0) / scene.log_scales[0].exp()
    torch.testing.assert_close(spread, torch.ones(3, dtype=torch.float64), rtol=0.05, atol=0)
    torch.testing.assert_close(along_axes.mean(dim=0), torch.zeros(3, dtype=torch.float64), rtol=0, atol=0.01)


def test_those_neither_kept_nor_split_are_gone_and_sources_point_to_the_rest():
    scene = scene_of(LOGITS)
    change = grow(scene, chosen(7, 1, 3, 6), chosen(7, 3), chosen(7, 4, 5), generator())
    assert change.source.tolist() == [1, 3, 6, -1, -1, -1, -1, -1]
    assert len(change.scene) == 8
    assert torch.equal(change.scene.colours, scene.colours[torch.tensor([1, 3, 6, 3, 4, 5, 4, 5])])
    change.scene.check()


def test_the_given_scene_keeps_its_numbers_and_the_result_no_graph():
    scene = scene_of(LOGITS).map(lambda tensor: tensor.requires_grad_(True))
    before = scene.map(lambda tensor: tensor.detach().clone())
    change = grow(scene, chosen(7, 0, 1), chosen(7, 1), chosen(7, 2), generator())
    for name, tensor in change.scene.parameters().items():
        assert not tensor.requires_grad
        tensor.add_(1)
        assert torch.equal(scene.parameters()[name].detach(), before.parameters()[name])


def test_an_empty_scene_stays_empty():
    change = grow(scene_of(()), chosen(0), chosen(0), chosen(0), generator())
    assert len(change.scene) == 0
    assert change.source.dtype == torch.int64


RULES = (Osgr.generous(), Mcmc(), Revised())


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
@pytest.mark.parametrize("seed", range(3))
def test_a_rule_applied_to_some_leaves_the_others_as_they_are(line, evidence, rule, seed):
    """Though these are the ones that move most, are widest, and have the largest error, or are nearly transparent."""
    draw = generator(seed)
    scene = line(40, opacity=torch.rand(40, generator=draw).clamp(0.01, 0.9))
    rows = torch.rand(40, generator=draw) < 0.7
    others = torch.nonzero(~rows).flatten()
    scene.opacity_logits[others[::2]] = -20.0
    inside = torch.nonzero(rows).flatten().tolist()
    scene.opacity_logits[inside[0]] = -20.0
    ranked = [*inside[::3], *others.tolist()]
    told = evidence(40, moved=ranked, wide=ranked, wrong=ranked, cap=48)
    change = change_among(rule, rows, scene, told, generator())
    assert torch.equal(change.source[-len(others) :], others)
    assert not torch.isin(change.source[: -len(others)], others).any()
    alone = scene.map(lambda tensor: tensor[rows])
    expected = rule.change(alone, told.among(rows), generator())
    assert (expected.source < 0).any()
    for name, tensor in change.scene.parameters().items():
        assert torch.equal(tensor[-len(others) :], scene.parameters()[name][others]), name
        assert torch.equal(tensor[: -len(others)], expected.scene.parameters()[name]), name
    kept = expected.source >= 0
    assert change.source[: -len(others)][kept].tolist() == [inside[k] for k in expected.source[kept]]
    assert (change.source[: -len(others)][~kept] == -1).all()
    assert len(change.scene) <= 48


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_a_rule_applied_to_all_is_the_rule(line, evidence, rule):
    scene, told = line(20), evidence(20, moved=(3, 4), wide=(7,), wrong=(5,))
    change = change_among(rule, torch.ones(20, dtype=torch.bool), scene, told, generator())
    expected = rule.change(scene, told, generator())
    assert torch.equal(change.source, expected.source)
    for name, tensor in change.scene.parameters().items():
        assert torch.equal(tensor, expected.scene.parameters()[name])
