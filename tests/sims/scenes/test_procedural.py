"""Laws that all scenes on a stage obey, and what is particular to each."""

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.harmonics import SH_DC, basis, colours_seen
from gs2ci_sims.radiance import Renderer, rendered_depth
from gs2ci_sims.scenes.ball import LIGHT, ball, highlight, sphere_depth
from gs2ci_sims.scenes.rectangles import Rectangle, depth_of, receding, shade
from gs2ci_sims.scenes.rooms import boxes, corridor, moving_box, textureless, thicket
from gs2ci_sims.scenes.stage import SuggestedCamera, room

FRAME, FINE = SuggestedCamera((48, 72), 50.0), SuggestedCamera((136, 200), 50.0)
MAKERS = [boxes, moving_box, thicket, corridor, ball, textureless]


def make(maker, seed=0, frame=FRAME, **options):
    return maker(np.random.default_rng(seed), frame, **options)


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_true_depth_is_that_of_the_rendered_surfaces_and_nothing_is_left_open(maker):
    scene = make(maker, frame=FINE)
    rendered = rendered_depth(scene.gaussians, np.eye(4), scene.intrinsics, scene.size)
    error = np.abs(rendered - scene.depth) / scene.depth
    assert np.isfinite(scene.depth).all()
    assert np.median(error) < 0.02  # along walls a pixel sees a range of depths
    # Where a pixel holds more than one surface, depth has more than one answer; in a thicket that is so for many.
    assert np.mean(error > 0.05) < (0.45 if maker is thicket else 0.1)
    _, coverage = Renderer().views(scene, np.eye(4)[None])
    assert coverage.min() > 0.97


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_the_same_seed_builds_the_same_scene_and_another_one_another(maker):
    first, again, other = (make(maker, seed).gaussians for seed in (1, 1, 2))
    assert torch.equal(first.means, again.means)
    assert torch.equal(first.colours, again.colours)
    assert first.colours.shape != other.colours.shape or not torch.equal(first.colours, other.colours)


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_colours_lie_in_the_range_of_a_view(maker):
    radiance, _ = Renderer().views(make(maker), np.eye(4)[None])
    assert 0 <= radiance.min() <= radiance.max() <= 1.25
    assert radiance.std() > 0.05


def test_a_wider_field_of_view_sees_more_of_the_same_corridor():
    narrow, wide = (make(corridor, frame=SuggestedCamera((48, 72), angle)) for angle in (30.0, 70.0))
    assert wide.depth.min() < 0.6 * narrow.depth.min()


def test_a_corridor_spans_a_depth_range_of_more_than_ten():
    depth = make(corridor, length=40.0).depth
    assert depth.max() / depth.min() > 10


def test_stems_are_as_narrow_as_stated():
    depth = make(thicket, frame=SuggestedCamera((96, 144), 50.0), stems=1, twigs=0, width_px=(3.0, 3.0), near=2.0).depth
    wall_only = make(
        thicket, frame=SuggestedCamera((96, 144), 50.0), stems=1, twigs=0, width_px=(1e-6, 1e-6), near=2.0
    ).depth
    rows = np.sum(np.abs(depth - wall_only) > 1e-9, axis=1)
    rows = rows[rows > 0]
    assert rows.size > 20
    assert 2.5 < np.median(rows) < 3.8


def test_the_box_that_is_to_fly_lies_within_its_ball_and_nothing_else_does():
    centre, radius = np.array([-0.4, -0.25, 3.0]), 0.45
    with_box = make(moving_box, centre=tuple(centre), radius=radius).gaussians
    distance = np.linalg.norm(with_box.means.numpy() - centre, axis=1)
    inside = with_box.colours[torch.tensor(distance <= radius)]
    assert len(inside) > 500
    assert ((distance <= radius) | (distance > 1.2 * radius)).all()
    red, green, blue = inside.mean(dim=0)
    assert red > green > blue  # its paint


def test_only_the_box_and_the_rooms_edges_show_anything_in_a_textureless_room():
    scene = make(textureless, frame=FINE)
    room_alone = make(textureless, frame=FINE, edge=1e-3).depth
    radiance = Renderer().views(scene, np.eye(4)[None])[0][0]
    slope = np.hypot(*np.gradient(radiance.mean(axis=-1)))
    is_box = np.abs(scene.depth - room_alone) > 0.05
    assert 0.01 < is_box.mean() < 0.05
    assert np.mean(slope > 0.003) < 0.12
    assert np.mean(slope[~is_box] > 0.003) < 0.08
    assert np.mean(slope[is_box] > 0.003) > 0.9


def test_a_highlights_harmonics_are_the_lobes_projection():
    normals = -np.array([[0.0, 0.0, 1.0], [0.36, 0.48, 0.8]])
    constant, rest = highlight(normals, shine=0.7, exponent=6.0)
    z, weights = np.polynomial.legendre.leggauss(24)
    angle = (np.arange(48) + 0.5) / 48 * 2 * np.pi
    grid_z, phi = (axis.ravel() for axis in np.meshgrid(z, angle, indexing="ij"))
    ring = np.sqrt(1 - grid_z**2)
    directions = np.stack([ring * np.cos(phi), ring * np.sin(phi), grid_z], axis=1)
    area = weights.repeat(48) * 2 * np.pi / 48
    for normal, first, others in zip(normals, constant, rest, strict=True):
        reflected = directions - 2 * (directions @ normal)[:, None] * normal
        lobe = 0.7 * np.maximum(reflected @ LIGHT, 0) ** 6
        np.testing.assert_allclose(first, area @ lobe * SH_DC**2, rtol=1e-3)
        np.testing.assert_allclose(others, (area * lobe) @ basis(torch.tensor(directions)).numpy(), atol=2e-3)


def test_a_highlight_is_seen_where_a_mirror_would_show_the_light():
    normal = np.array([[0.0, 0.0, -1.0]])
    _, rest = highlight(normal, 1.0, 8.0)
    mirror = LIGHT - 2 * LIGHT[2] * np.array([0, 0, 1.0])
    directions = np.random.default_rng(0).standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = basis(torch.tensor(directions)).numpy() @ rest[0]
    assert directions[seen.argmax()] @ mirror > 0.99


def test_a_point_that_the_light_does_not_reach_has_no_highlight():
    constant, rest = highlight(-LIGHT[None], 1.0, 8.0)
    assert constant[0] == 0
    assert not rest.any()


def test_the_balls_colours_change_with_the_cameras_place_and_a_dull_balls_do_not():
    moved = np.eye(4)
    moved[0, 3] = 0.4
    poses = torch.tensor(np.stack([np.eye(4), moved]), dtype=torch.float32)
    for shine, changes in ((0.0, False), (0.8, True)):
        scene = make(ball, shine=shine)
        here, there = colours_seen(scene.gaussians, poses)
        assert bool(((here - there).abs().max() > 0.05).item()) == changes
        walls = scene.gaussians.harmonics.abs().amax(dim=(1, 2)) == 0
        assert torch.equal(here[walls], there[walls])


def test_a_sphere_is_nearest_in_the_middle_by_its_radius():
    frame = SuggestedCamera((49, 49), 40.0)
    depth = sphere_depth(np.array([0.0, 0.0, 5.0]), 1.0, frame)
    assert np.nanmin(depth) == pytest.approx(4.0, abs=1e-9)
    assert depth[24, 24] == pytest.approx(4.0, abs=1e-9)
    assert np.isnan(depth[0, 0])


def test_strips_of_a_receding_surface_join_without_a_gap():
    strips = receding(np.array([0, 1.0]), np.array([2.0, 0]), 1.5, 20.0)
    begins = [strip.centre[2] - strip.half_v[2] for strip in strips]
    ends = [strip.centre[2] + strip.half_v[2] for strip in strips]
    assert begins[0] == pytest.approx(1.5)
    assert ends[-1] == pytest.approx(20.0)
    np.testing.assert_allclose(begins[1:], ends[:-1])
    assert max(np.array(ends) / begins) <= 1.2 + 1e-9


def test_depth_is_the_same_where_a_rectangle_reaches_behind_the_camera():
    floor = Rectangle(np.array([0, 1.0, 4.0]), np.array([3.0, 0, 0]), np.array([0, 0, 5.0]))
    depth = depth_of([floor], FRAME.intrinsics, FRAME.size)
    down = (47.5 - FRAME.intrinsics[1, 2]) / FRAME.focal
    assert depth[47, 36] == pytest.approx(1 / down)
    assert np.isnan(depth[:24]).all()


def test_a_face_towards_the_light_is_brighter_than_one_away_from_it():
    up = Rectangle(np.array([0, 1.0, 3.0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    right = Rectangle(np.array([-1.0, 0, 3.0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0]))
    assert shade(up) > 0.7
    assert shade(right) == pytest.approx(0.35)


@pytest.mark.parametrize(
    ("maker", "options"),
    [
        (boxes, {"count": 0}),
        (boxes, {"backdrop": -1.0}),
        (moving_box, {"radius": 4.0}),
        (moving_box, {"centre": (0.0, 0.0, 5.9)}),
        (thicket, {"stems": 0}),
        (thicket, {"width_px": (0.0, 2.0)}),
        (thicket, {"near": 5.9}),
        (textureless, {"edge": 0.0}),
        (textureless, {"edge": 4.5}),
        (textureless, {"depth": 5.8}),
        (textureless, {"backdrop": float("inf")}),
        (corridor, {"length": 0.5}),
        (corridor, {"half_width": -1.0}),
        (ball, {"radius": 5.0}),
        (ball, {"depth": 5.9}),
        (ball, {"exponent": 0.5}),
        (ball, {"shine": -1.0}),
    ],
)
def test_geometry_that_cannot_be_is_refused(maker, options):
    with pytest.raises(InputError, match="allowed"):
        make(maker, **options)


def test_a_room_needs_a_wall_in_front_of_the_camera():
    with pytest.raises(InputError, match="a wall at depth"):
        room(np.random.default_rng(0), FRAME, float("inf"))
