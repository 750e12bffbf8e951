import pytest
import torch

from gs2ci.reconstruct.paper.density.revised import Revised

LARGE = 0.1


def change(scene, seen, seed=0, **rule):
    return Revised(**rule).change(scene, seen, torch.Generator().manual_seed(seed))


def log_transmittance(logits):
    return -torch.nn.functional.softplus(logits.double(), threshold=float("inf"))


def test_errors_and_not_gradients_ask_for_company(line, evidence):
    result = change(line(40), evidence(40, moved=(3,), wrong=(7,)))
    assert result.source.tolist() == [*range(40), -1]
    assert torch.equal(result.scene.means[40], result.scene.means[7])


def test_the_threshold_is_that_of_the_error(line, evidence):
    at_most_one = evidence(40, wrong=(7,))
    assert len(change(line(40), at_most_one, error=1.0).scene) == 40
    assert len(change(line(40), at_most_one, error=0.999).scene) == 41


@pytest.mark.parametrize("opacity", [0.01, 0.5, 0.999])
def test_a_duplicate_and_its_original_let_through_what_the_one_did(opacity, line, evidence):
    result = change(line(40, opacity), evidence(40, wrong=(7,)), sinking=0.0)
    both = log_transmittance(result.scene.opacity_logits[[7, 40]]).sum()
    torch.testing.assert_close(both, log_transmittance(line(1, opacity).opacity_logits)[0], rtol=1e-5, atol=0)


def test_children_keep_the_opacity_of_their_parent(line, evidence):
    result = change(line(40, 0.6, size=LARGE), evidence(40, wrong=(7,)), sinking=0.0)
    assert result.source.tolist() == [i for i in range(40) if i != 7] + [-1, -1]
    torch.testing.assert_close(result.scene.opacity_logits, line(41, 0.6).opacity_logits, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("cap", "born"), [(10**6, 5), (103, 3), (100, 0), (50, 0)])
def test_growth_is_bounded_by_its_share_and_by_the_cap_and_the_worst_come_first(cap, born, line, evidence):
    result = change(line(100), evidence(100, wrong=range(20, 60), cap=cap))
    assert sorted(result.scene.means[100:, 0].tolist()) == list(range(60 - born, 60))


def test_every_opacity_sinks_by_the_same_at_every_turn(line, evidence):
    opacity = torch.linspace(0.01, 0.99, 40)
    sunk = torch.sigmoid(change(line(40, opacity), evidence(40)).scene.opacity_logits)
    torch.testing.assert_close(opacity - sunk, torch.full((40,), 0.001), rtol=0, atol=1e-6)


@pytest.mark.parametrize("logit", [-100.0, -7.0, 20.0, 100.0])
def test_sinking_stays_finite_at_both_ends(logit, line, evidence):
    scene = line(40)
    scene.opacity_logits[5] = logit
    result = change(scene, evidence(40, iteration=5000))
    result.scene.check()
    if logit > 0:  # an opacity of one sinks like any other
        assert float(torch.sigmoid(result.scene.opacity_logits[5])) == pytest.approx(0.999, abs=1e-6)


def test_opacities_are_never_reset(line, evidence):
    result = change(line(40, 0.9), evidence(40, iteration=3000))
    assert result.forget == frozenset()
    assert (torch.sigmoid(result.scene.opacity_logits) > 0.89).all()


def test_the_faint_are_removed_and_make_room(line, evidence):
    opacity = torch.full((40,), 0.5)
    opacity[[0, 7]] = 0.004
    result = change(line(40, opacity), evidence(40, wrong=(6, 7, 8), cap=40))
    assert len(result.scene) == 40
    assert sorted(result.scene.means[38:, 0].tolist()) == [6.0, 8.0]


def test_nothing_is_shaken(line):
    assert Revised().shake(line(4), 1.0, torch.Generator()) is None
