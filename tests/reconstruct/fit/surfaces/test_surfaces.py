"""Surfaces found in the views of a fit, and the term that gathers light there."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.depth_field import FieldStep
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, Surfaces, SurfaceSettings, find_surfaces
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.render.backend import load_backend
from gs2ci.render.conventions import NEAR
from gs2ci.render.gaussians import Gaussians, joined
from tests.render.pretended_card import lies_there, pretended_card

SIZE = (40, 56)
INTRINSICS = np.array([[60.0, 0, 28], [0, 60.0, 20], [0, 0, 1]])
VIEWS = 5
DEPTH = 2.0
SETTINGS = SurfaceSettings(sweep=SweepSettings(planes=32))


def path(views=VIEWS, extent=0.4):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -np.linspace(-extent / 2, extent / 2, views)
    return poses


def wall(depth=DEPTH, logit=6.0, seed=0):
    """Flat, many-coloured Gaussians across the view at one depth."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(-1.4, 1.41, 0.07) * depth / 2, np.arange(-1, 1.01, 0.07) * depth / 2)
    count = x.size
    quaternions = torch.zeros(count, 4)
    quaternions[:, 0] = 1
    return Gaussians(
        means=torch.tensor(np.stack([x.ravel(), y.ravel(), np.full(count, depth)], 1), dtype=torch.float32),
        log_scales=torch.tensor([0.035 * depth / 2, 0.035 * depth / 2, 1e-3]).log().repeat(count, 1),
        quaternions=quaternions,
        opacity_logits=torch.full((count,), logit),
        colours=torch.tensor(rng.random((count, 3)), dtype=torch.float32),
    )


@pytest.fixture(scope="module")
def renderer():
    masks = (np.random.default_rng(1).random((VIEWS, *SIZE)) < 0.3).astype(np.float32)
    masks[0, 0, 0] = 1
    shot = Shot(np.ones((*SIZE, 3), np.float32), masks, np.ones(VIEWS, np.float32), intrinsics=INTRINSICS).check()
    return ShotRenderer(shot, INTRINSICS, load_backend())


def surfaces_of(renderer, scene=None, poses=None, **changes):
    scene, poses = wall() if scene is None else scene, path() if poses is None else poses
    views = renderer.views(scene, torch.from_numpy(poses).float())
    return find_surfaces(renderer, scene, poses, views, replace(SETTINGS, **changes), seed=0)


def term(found: Surfaces, renderer, scene, turn=0, weight=1.0):
    return found.draw(renderer, scene, torch.from_numpy(path()).float(), turn, weight)


def test_a_wall_is_found_where_it_stands_and_believed(renderer):
    found = surfaces_of(renderer)
    middle = np.s_[:, 8:-8, 12:-12]
    assert found.views == (0, 1, 3, 4)
    assert found.parallax_px == pytest.approx(60 * 0.4)
    assert np.median(np.abs(DEPTH * found.inverse_depth[middle].numpy() - 1)) < 0.02
    assert found.trust[middle].mean() > 0.9


def test_a_view_that_agrees_with_no_other_is_left_out_and_the_others_are_kept(renderer):
    poses = path()
    turn = np.deg2rad(80)
    poses[-1, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]] @ poses[-1, :3]
    found = surfaces_of(renderer, poses=poses)
    assert found.views == (0, 1, 3)
    assert len(found.inverse_depth) == len(found.trust) == len(found.pixels) == 3
    middle = np.s_[:, 8:-8, 12:-12]
    assert np.median(np.abs(DEPTH * found.inverse_depth[middle].numpy() - 1)) < 0.02
    assert found.trust[middle].mean() > 0.8
    scene = wall(1.6)
    for turn in range(4):
        assert found.draw(renderer, scene, torch.from_numpy(poses).float(), turn, 1.0) > 1
    assert torch.isfinite(scene.means.grad).all()


def test_where_no_view_agrees_with_another_there_are_none(renderer):
    poses = path(views=VIEWS)
    for k, turn in enumerate(np.deg2rad([0, 80, 160, 240, 320])):
        poses[k, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]] @ poses[k, :3]
    assert surfaces_of(renderer, poses=poses) is None


def test_the_term_is_small_on_the_surface_and_grows_with_the_distance(renderer):
    found = surfaces_of(renderer)
    at = {depth: float(term(found, renderer, wall(depth))) for depth in (1.6, 1.8, 2.0, 2.2, 2.4)}
    assert at[2.0] < 0.4
    assert at[1.6] > at[1.8] > at[2.0] < at[2.2] < at[2.4]
    # The distance is that in parallax along the whole path.
    assert at[1.6] == pytest.approx(24 * (1 / 1.6 - 1 / 2), abs=0.5)


def test_fog_before_a_wall_costs_and_its_gradient_thins_it_and_moves_it_to_the_wall(renderer):
    found = surfaces_of(renderer)
    foggy = joined([wall(1.5, logit=-1.0, seed=3), wall()])
    fog = slice(0, len(foggy) // 2)
    assert term(found, renderer, foggy) > term(found, renderer, wall()) + 0.5
    leaf = foggy.map(torch.clone)
    term(found, renderer, leaf)
    seen = leaf.opacity_logits.grad[fog].abs() > 0
    assert seen.sum() > 200
    assert (leaf.opacity_logits.grad[fog][seen] > 0).double().mean() > 0.95
    assert leaf.means.grad[fog, 2].sum() < 0
    assert all(torch.isfinite(value.grad).all() for name, value in leaf.parameters().items() if name != "colours")


def test_surfaces_and_their_gradient_are_the_same_bits_on_any_number_of_threads(renderer, threads):
    foggy, found = joined([wall(1.5, logit=-1.0, seed=3), wall()]), []
    for count in (1, 2, 2):
        with threads(count):
            surfaces = surfaces_of(renderer, foggy)
            leaf = foggy.map(torch.clone)
            term(surfaces, renderer, leaf)
            found.append(
                (surfaces.inverse_depth, surfaces.trust, leaf.means.grad.numpy(), leaf.opacity_logits.grad.numpy())
            )
    for other in found[1:]:
        for one, again in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, again)


def definition(found, renderer, scene, turn):
    """The term in torch, by one rendering with a graph: differentiable."""
    view, pixels = found.views[turn], found.pixels[turn].at
    pose = torch.from_numpy(path()[view]).float()
    scene = scene.at(float(renderer.times[view])) if scene.motion is not None else scene
    depth = (scene.means @ pose[2, :3] + pose[2, 3]).clamp(min=NEAR)
    wanted = found.parallax_px * found.inverse_depth[turn].reshape(-1)[pixels]
    trust = found.trust[turn].reshape(-1)[pixels]
    middle = float(wanted.median())
    parallax = found.parallax_px / depth - middle
    moments = torch.stack([torch.ones_like(parallax), parallax, parallax.square()], dim=1)
    image = load_backend().coded(
        replace(scene, colours=moments), pose[None], renderer.intrinsics, found.pixels[turn].mask_set
    )
    stopped, first, second = image.reshape(-1, 3)[pixels].double().unbind(dim=1)
    wanted = wanted.double() - middle
    squares = second - 2 * wanted * first + wanted.square() * stopped
    distances = (squares.clamp(min=0) + 0.1**2).sqrt() - 0.1
    return (trust * distances).sum() / max(float(trust.sum()), 1.0)


@pytest.mark.parametrize("moves", [False, True])
def test_the_term_and_its_gradient_are_those_of_the_definition(renderer, moves):
    found = surfaces_of(renderer)
    foggy = joined([wall(1.5, logit=-1.0, seed=3), wall()])
    foggy.means[:5, 2] = -1.0  # behind the camera
    if moves:
        foggy = replace(foggy, motion=torch.full((len(foggy), 2, 3), 0.01))
    ours, exact = (foggy.map(lambda tensor: tensor.clone().requires_grad_()) for _ in range(2))
    expected = definition(found, renderer, exact, 1)
    (0.3 * expected).backward()
    assert term(found, renderer, ours, 1, 0.3) == pytest.approx(float(expected.detach()), rel=1e-4)
    for name, tensor in exact.parameters().items():
        if name != "colours":
            scale = float(tensor.grad.abs().max())
            torch.testing.assert_close(ours.parameters()[name].grad, tensor.grad, rtol=1e-3, atol=2e-4 * scale)


def test_views_are_looked_at_in_turn(renderer):
    found = surfaces_of(renderer)
    beside = wall(1.7)
    each = [float(term(found, renderer, beside, turn)) for turn in range(5)]
    assert each[0] == each[4]
    assert len({round(value, 6) for value in each[:4]}) == 4


def test_where_there_is_no_parallax_or_nothing_is_seen_no_surface_is_claimed(renderer):
    at_rest = np.tile(np.eye(4), (VIEWS, 1, 1))
    assert surfaces_of(renderer, poses=at_rest) is None
    assert surfaces_of(renderer, scene=wall(logit=-20.0)) is None


def test_the_weight_fades_over_the_rest_of_the_schedule():
    search = Search(0.5, 1e-2, 1e-4)
    assert search.weight_at(0.5) == pytest.approx(1e-2)
    assert search.weight_at(0.75) == pytest.approx(1e-3)
    assert search.weight_at(1.0) == pytest.approx(1e-4)
    assert Search(1.0, 1e-2, 1e-4).weight_at(1.0) == pytest.approx(1e-2)


def test_surfaces_move_with_a_field_over_depth_as_the_scene_does(renderer):
    found, scene, poses = surfaces_of(renderer), wall(), torch.from_numpy(path())
    # The wall is brought nearer, its right half more so.
    nearer = np.broadcast_to(np.array([0.02, 0.02, 0.1])[:, None, None], (3, 2, 2))
    step = FieldStep(poses[VIEWS // 2].numpy(), np.array([-0.5, -0.4, 0.2]), np.array([0.5, 0.8, 0.6]), nearer)
    step.of_scene(scene)
    found = found.moved(step, poses)
    moved = 1 / renderer.stopped_light(scene, poses.numpy()).surface().numpy()
    looked = np.zeros(SIZE, bool)
    for inverse_depth, pixels, view in zip(found.inverse_depth, found.pixels, found.views, strict=True):
        looked[:] = False
        looked.reshape(-1)[pixels.at] = True
        looked[:, :14] = looked[:, -14:] = False
        assert np.median(np.abs(inverse_depth.numpy() / moved[view] - 1)[looked]) < 0.02
    assert moved[2][20, 42] > 1.05 * moved[2][20, 14]


SOUND = Search(0.3, 1e-2, 1e-3)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"searches": (replace(SOUND, weight=0.0),)}, "weight = 0.0 in Search"),
        ({"searches": (SOUND, replace(SOUND, final_weight=np.inf))}, "final_weight = inf in Search"),
        ({"searches": ()}, r"searches begin at \[\]"),
        ({"every": 0}, "every = 0 in SurfaceSettings"),
        ({"searches": (replace(SOUND, begins=0.0), SOUND)}, "begins = 0.0 in Search"),
        ({"searches": (replace(SOUND, begins=0.8), SOUND)}, r"searches begin at \[0.8, 0.3\]"),
        ({"searches": (replace(SOUND, begins=1.2),)}, "begins = 1.2 in Search"),
        ({"pixel_share": 1.5}, "pixel_share = 1.5 in SurfaceSettings"),
        ({"views": 1}, "views = 1 in SurfaceSettings"),
        ({"others": 1}, "others = 1 in SurfaceSettings"),
    ],
)
def test_settings_without_meaning_are_refused(wrong, said):
    with pytest.raises(InputError, match=said):
        SurfaceSettings(**wrong).check()


def test_surfaces_lie_where_the_scene_does_and_move_there(renderer):
    pytest.importorskip("warp", reason="Warp is not installed")
    poses, still = torch.from_numpy(path()), np.zeros((3, 2, 2))
    step = FieldStep(path()[VIEWS // 2], np.array([-0.5, -0.4, 0.2]), np.array([0.5, 0.8, 0.6]), still + 0.05)
    here = surfaces_of(renderer).moved(step, poses)
    with pretended_card():
        there = ShotRenderer(renderer.shot, INTRINSICS, load_backend("warp"))
        scene = wall().map(lambda tensor: tensor.to(there.device))
        views = there.views(scene, poses.float())
        found = find_surfaces(there, scene, path(), views, SETTINGS, seed=0).moved(step, poses)
        distance = term(found, there, scene).cpu()
        bare = found.without_masks()
        again = bare.with_masks(there)
    for one in (found, again):
        assert all(map(lies_there, (one.inverse_depth, one.trust, one.rays, *(each.at for each in one.pixels))))
    assert not any(map(lies_there, (bare.inverse_depth, bare.trust, bare.rays, *(each.at for each in bare.pixels))))
    apart = np.abs(bare.inverse_depth.numpy() - here.inverse_depth.numpy())
    assert np.median(apart) < 1e-4
    assert float(distance) == pytest.approx(float(term(here, renderer, wall())), rel=0.05)
