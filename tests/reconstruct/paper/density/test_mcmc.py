import math

import pytest
import torch

from gs2ci.reconstruct.paper.density.mcmc import Mcmc
from gs2ci.render.gaussians import Gaussians, rotation_matrices


def change(scene, seen, seed=0, **rule):
    return Mcmc(**rule).change(scene, seen, torch.Generator().manual_seed(seed))


def log_transmittance(logits):
    return -torch.nn.functional.softplus(logits.double(), threshold=float("inf"))


def through_places(scene):
    """What each place lets through, all Gaussians there together, by place."""
    places = scene.means[:, 0].long()
    return torch.zeros(int(places.max()) + 1, dtype=torch.float64).index_add(
        0, places, log_transmittance(scene.opacity_logits)
    )


def mixed(line, count=200, faint=60, seed=0):
    draw = torch.Generator().manual_seed(seed)
    opacity = 0.01 + 0.98 * torch.rand(count, generator=draw)
    opacity[torch.randperm(count, generator=draw)[:faint]] = 0.003
    return line(count, opacity), opacity <= 0.005


def test_a_scene_without_faint_ones_and_without_room_is_left_alone(line, evidence):
    scene = line(40)
    result = change(scene, evidence(40, cap=40))
    assert result.source.tolist() == list(range(40))
    for name, tensor in result.scene.parameters().items():
        assert torch.equal(tensor, scene.parameters()[name])


def test_the_faint_move_to_the_opaque_and_each_place_lets_through_what_it_did(line, evidence):
    scene, faint = mixed(line)
    result = change(scene, evidence(200, cap=200))
    assert len(result.scene) == 200
    assert (torch.sigmoid(result.scene.opacity_logits) > 0.005 * (1 - 1e-5)).all()
    before, after = log_transmittance(scene.opacity_logits), through_places(result.scene)
    torch.testing.assert_close(
        after[~faint[: len(after)]], before[: len(after)][~faint[: len(after)]], rtol=1e-5, atol=0
    )
    moved_to = result.scene.means[faint, 0].long()
    assert not faint[moved_to].any()
    assert (moved_to != torch.nonzero(faint).flatten()).all()


def test_the_opaque_are_chosen_in_proportion_to_their_opacity(line, evidence):
    opacity = torch.full((4000,), 0.001)
    opacity[:2] = torch.tensor([0.9, 0.3])
    draws = [change(line(4000, opacity), evidence(4000, cap=4000), seed, transparent=1e-3) for seed in range(8)]
    joined = torch.cat([each.scene.means[2:, 0] for each in draws])
    first, second = int((joined == 0).sum()), int((joined == 1).sum())
    # 8 × 3998 draws would go 3 : 1; those that a place cannot afford are left out, the fainter place's first.
    assert first > 2 * second > 0


@pytest.mark.parametrize("opacity", [0.2, 0.9999, 1 - 2**-24])
def test_thousands_of_copies_in_one_place_stay_visible_and_let_through_what_the_one_did(opacity, line, evidence):
    given = torch.full((5000,), 0.004)
    given[0] = opacity
    scene = line(5000, given)
    result = change(scene, evidence(5000, cap=5000))
    here = result.scene.means[:, 0] == 0
    logits = result.scene.opacity_logits[here]
    afforded = float(log_transmittance(scene.opacity_logits[:1])) / math.log1p(-0.005)
    assert len(logits) == min(5000, int(afforded))
    assert torch.equal(logits, logits[:1].expand(len(logits)))
    assert (torch.sigmoid(logits) > 0.005 * (1 - 1e-5)).all()
    torch.testing.assert_close(
        log_transmittance(logits).sum(), log_transmittance(scene.opacity_logits[0]), rtol=1e-5, atol=0
    )
    assert (result.scene.log_scales[here] <= scene.log_scales[0]).all()
    result.scene.check()


def test_those_for_whom_there_is_no_place_stay_as_they_are(line, evidence):
    opacity = torch.full((10,), 0.004)
    opacity[0] = 0.008  # one layer and a half of the least: cannot be shared
    scene = line(10, opacity)
    result = change(scene, evidence(10, cap=10))
    assert result.source.tolist() == list(range(10))
    assert torch.equal(result.scene.opacity_logits, scene.opacity_logits)


def test_a_wholly_faint_scene_stays_as_it_is(line, evidence):
    scene = line(10, 0.001)
    result = change(scene, evidence(10))
    assert result.source.tolist() == list(range(10))
    assert torch.equal(result.scene.means, scene.means)


def test_an_empty_scene_stays_empty(line, evidence):
    assert len(change(line(0), evidence(0)).scene) == 0


@pytest.mark.parametrize(("cap", "count"), [(10**6, 105), (102, 102), (100, 100), (20, 100)])
def test_newcomers_are_a_share_of_the_population_up_to_the_cap(cap, count, line, evidence):
    scene = line(100)
    result = change(scene, evidence(100, cap=cap))
    assert len(result.scene) == count
    assert (result.source[100:] == -1).all()
    torch.testing.assert_close(through_places(result.scene), log_transmittance(scene.opacity_logits), rtol=1e-5, atol=0)


def test_whoever_moves_or_shares_starts_anew_in_the_optimiser(line, evidence):
    scene, faint = mixed(line)
    result = change(scene, evidence(200, cap=200))
    changed = result.scene.opacity_logits != scene.opacity_logits
    assert changed[faint].all()
    assert torch.equal(result.source == -1, changed)
    kept = ~changed
    assert torch.equal(result.source[kept], torch.nonzero(kept).flatten())


def test_the_generator_alone_decides_the_draws(line, evidence):
    scene, _ = mixed(line)
    first, again, other = (change(scene, evidence(200, cap=200), seed) for seed in (1, 1, 2))
    assert torch.equal(first.scene.means, again.scene.means)
    assert not torch.equal(first.scene.means, other.scene.means)


def turned(count, opacity):
    draw = torch.Generator().manual_seed(4)
    quaternion = torch.randn(1, 4, generator=draw)
    return Gaussians(
        means=torch.zeros(count, 3),
        log_scales=torch.tensor([[0.3, 0.1, 0.02]]).log().repeat(count, 1),
        quaternions=quaternion.repeat(count, 1),
        opacity_logits=torch.logit(torch.full((count,), opacity)),
        colours=torch.zeros(count, 3),
    )


def test_shaking_is_the_covariance_times_a_normal_draw_times_the_fall_with_opacity():
    """Kheradmand et al. 2024, eq. 7: λ · rate · σ(−100 (α − 0.005)) Σ η, so that its covariance is that squared."""
    scene, rate = turned(20_000, 0.005), 2e-6
    moves = Mcmc().shake(scene, rate, torch.Generator().manual_seed(0)).double()
    turn = rotation_matrices(scene.quaternions[:1])[0].double()
    covariance = turn @ torch.diag((2 * scene.log_scales[0].double()).exp()) @ turn.T
    expected = (0.5 * 5e5 * rate) ** 2 * covariance @ covariance
    torch.testing.assert_close(moves.T @ moves / len(moves), expected, rtol=0.05, atol=0.02 * float(expected.max()))


@pytest.mark.parametrize(
    ("opacity", "fade"), [(1e-6, 0.6224), (0.005, 0.5), (0.055, 0.00669), (0.5, 0.0), (1 - 2e-7, 0.0)]
)
def test_the_opaque_are_not_shaken(opacity, fade):
    rate = 2e-6
    shaken, half = (Mcmc().shake(turned(500, a), rate, torch.Generator().manual_seed(0)) for a in (opacity, 0.005))
    torch.testing.assert_close(shaken, half * (fade / 0.5), rtol=2e-3, atol=1e-12)


def test_an_empty_scene_is_shaken_without_complaint():
    assert Mcmc().shake(turned(0, 0.5), 1e-3, torch.Generator()).shape == (0, 3)
