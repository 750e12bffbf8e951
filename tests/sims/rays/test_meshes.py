"""Rays through triangles against the plane that they lie in and the texture painted on it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci_sims.rays.meshes import Gloss, TexturedMesh, trace_mesh

SIZE = (24, 32)
INTRINSICS = np.array([[30.0, 0, 16.2], [0, 31.0, 11.7], [0, 0, 1]])
SLANTED = np.array([[-1.5, -1.2, 2.0], [1.8, -1.0, 3.5], [-0.2, 1.9, 2.6]])
UV = np.array([[0.1, 0.2], [0.9, 0.3], [0.4, 0.8]])


def mesh(corners, texture, uv=UV):
    corners = np.atleast_3d(corners).reshape(-1, 3, 3)
    count = len(corners)
    return TexturedMesh(corners, np.broadcast_to(uv, (count, 3, 2)).copy(), np.zeros(count, int), (texture,))


def ramp(rows=64, columns=64):
    """A texture that rises linearly: bilinear interpolation is exact for it, away from its rim."""
    down, right = np.mgrid[:rows, :columns] + 0.5
    return np.stack([right / columns, down / rows, 0.5 * (right / columns + down / rows)], axis=2).astype(np.float64)


def rays():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    return np.stack(
        [(x - INTRINSICS[0, 2]) / INTRINSICS[0, 0], (y - INTRINSICS[1, 2]) / INTRINSICS[1, 1], np.ones(SIZE)], -1
    )


def barycentric():
    """Depth and barycentric coordinates of each ray's meeting with the triangle's plane: one 3 x 3 system per ray.

    d t = sum_k b_k c_k with sum_k b_k = 1: the b_k / t solve C^T (b / t) = d.
    """
    shares = rays() @ np.linalg.inv(SLANTED)
    depth = 1 / shares.sum(axis=-1)
    return depth, shares * depth[..., None]


def test_a_slanted_triangle_has_the_depth_of_its_plane_and_the_colours_painted_on_it():
    radiance, depth = trace_mesh(mesh(SLANTED, ramp()), np.eye(4), INTRINSICS, SIZE)
    plane, shares = barycentric()
    inside = (shares > 1e-6).all(axis=-1)
    assert 0.2 < inside.mean() < 0.8
    assert depth[inside] == pytest.approx(plane[inside], rel=1e-9)
    assert np.isinf(depth[(shares < -1e-6).any(axis=-1)]).all()
    where = shares[inside] @ UV
    expected = np.stack([where[:, 0], where[:, 1], 0.5 * where.sum(axis=1)], axis=1)
    assert radiance[inside] == pytest.approx(expected, rel=1e-9)


def test_the_nearer_of_two_triangles_hides_the_other_in_either_order():
    near = mesh(SLANTED, np.full((2, 2, 3), 0.9))
    both = [
        TexturedMesh(
            np.stack(pair), np.zeros((2, 3, 2)), np.array(which), (np.full((1, 1, 3), 0.9), np.zeros((1, 1, 3)))
        )
        for pair, which in (((SLANTED, 3 * SLANTED), [0, 1]), ((3 * SLANTED, SLANTED), [1, 0]))
    ]
    alone = trace_mesh(near, np.eye(4), INTRINSICS, SIZE)
    for pair in both:
        radiance, depth = trace_mesh(pair, np.eye(4), INTRINSICS, SIZE)
        assert radiance == pytest.approx(alone[0])
        assert np.array_equal(depth, alone[1])


def test_a_surface_of_many_triangles_leaves_no_crack():
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-4, 4, 40), np.linspace(-3, 3, 30))
    points = np.stack([x, y, 3 + 0.3 * rng.random(x.shape)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    corners = np.concatenate([np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((a, b, c), (a, c, d))])
    _, depth = trace_mesh(mesh(corners, np.ones((1, 1, 3))), np.eye(4), INTRINSICS, (240, 320))
    assert np.isfinite(depth[:24, :32]).all()


def test_a_floor_that_passes_under_the_camera_is_seen_ahead_and_nothing_behind():
    floor = np.array([[[-50, 1.0, -50], [50, 1.0, -50], [0, 1.0, 80.0]]])
    _, depth = trace_mesh(mesh(floor, np.ones((1, 1, 3))), np.eye(4), INTRINSICS, SIZE)
    slope = rays()[..., 1]
    below = slope > 0.05
    assert depth[below] == pytest.approx(1 / slope[below])
    assert np.isinf(depth[slope < 0]).all()


def test_textures_repeat_beyond_their_rim():
    flat = np.array([[-9.0, -9, 2], [9, -9, 2], [0, 9, 2]])
    stripes = np.zeros((1, 2, 3))
    stripes[0, 1] = 1.0
    first, again = (
        trace_mesh(mesh(flat, stripes, UV + shift), np.eye(4), INTRINSICS, SIZE)[0] for shift in (0.0, [3.0, -2.0])
    )
    assert first == pytest.approx(again, abs=1e-9)
    assert first.std() > 0.02


def test_tints_multiply_the_texture_and_run_evenly_between_the_corners():
    tints = np.array([[0.2, 1.0, 3.0], [0.9, 0.0, 0.5], [0.4, 0.3, 0.1]])
    plain, tinted = mesh(SLANTED, ramp()), replace(mesh(SLANTED, ramp()), tints=tints[None])
    bare, seen = (trace_mesh(one, np.eye(4), INTRINSICS, SIZE)[0] for one in (plain, tinted))
    _, shares = barycentric()
    inside = (shares > 1e-6).all(axis=-1)
    assert seen[inside] == pytest.approx(bare[inside] * (shares[inside] @ tints), rel=1e-9)
    assert tinted.brightest == pytest.approx(3 * plain.brightest)


def test_an_empty_mesh_and_one_without_area_are_dark():
    empty = TexturedMesh(np.zeros((0, 3, 3)), np.zeros((0, 3, 2)), np.zeros(0, int), ())
    line = mesh(np.array([[0, 0, 2.0], [1, 0, 2], [2, 0, 2]]), np.ones((1, 1, 3)))
    for nothing in (empty, line):
        radiance, depth = trace_mesh(nothing, np.eye(4), INTRINSICS, SIZE)
        assert not radiance.any()
        assert np.isinf(depth).all()
    assert empty.brightest == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"uv": np.zeros((2, 3, 2))}, "corners"),
        ({"corners": np.full((1, 3, 3), np.nan)}, "finite"),
        ({"which": np.array([1])}, "textures 1 to 1"),
        ({"textures": (np.full((2, 2, 3), -1.0),)}, "texture of shape"),
        ({"textures": (np.full((2, 2, 3), np.inf),)}, "infinite"),
        ({"tints": np.ones((2, 3, 3))}, "tints of shape"),
        ({"tints": np.full((1, 3, 3), -0.1)}, "tints of shape"),
        ({"tints": np.full((1, 3, 3), np.nan)}, "tints of shape"),
    ],
)
def test_a_mesh_that_does_not_fit_is_refused(change, words):
    parts = {"corners": SLANTED[None], "uv": UV[None], "which": np.array([0]), "textures": (np.ones((2, 2, 3)),)}
    with pytest.raises(InputError, match=words):
        TexturedMesh(**(parts | change))


LIGHT = np.array([0.2, -0.5, -0.9]) / np.linalg.norm([0.2, -0.5, -0.9])


def glossy(normals, shine=0.7, exponent=9.0, light=LIGHT):
    gloss = Gloss(np.broadcast_to(normals, (1, 3, 3)).copy(), np.array([shine]), exponent, light)
    return replace(mesh(SLANTED, np.full((2, 2, 3), 0.1)), gloss=gloss)


def corner_normals():
    bent = np.array([[0.2, -0.3, -1.0], [-0.4, -0.5, -1.0], [0.1, 0.4, -1.0]])
    return bent / np.linalg.norm(bent, axis=1, keepdims=True)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_highlight_is_phongs_lobe_about_the_mirrored_line_of_sight(sign):
    """The formula written out with vectors, from a camera that stands and looks elsewhere than along the axes."""
    turn = Rotation.from_rotvec([0.05, -0.1, 0.3]).as_matrix()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [0.1, -0.05, 0.2]
    normals = corner_normals()
    shiny = replace(glossy(normals), corners=(SLANTED - pose[:3, 3])[None] @ turn)
    shiny = replace(
        shiny, gloss=replace(shiny.gloss, normals=sign * (normals @ turn)[None], towards_light=LIGHT @ turn)
    )
    radiance, _ = trace_mesh(shiny, pose, INTRINSICS, SIZE)
    _, shares = barycentric()
    inside = (shares > 1e-6).all(axis=-1)
    sight = rays()[inside] / np.linalg.norm(rays()[inside], axis=1, keepdims=True)
    normal = shares[inside] @ normals
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    mirrored = sight - 2 * (sight * normal).sum(axis=1, keepdims=True) * normal
    lit = (normal @ LIGHT > 0) & ((sight * normal).sum(axis=1) < 0)
    expected = 0.1 + 0.7 * np.where(lit, np.maximum(mirrored @ LIGHT, 0) ** 9, 0)
    assert radiance[inside] == pytest.approx(np.repeat(expected[:, None], 3, axis=1), abs=1e-9)
    assert np.ptp(expected) > 0.05
    assert radiance.max() <= shiny.brightest


def test_a_highlight_moves_over_the_surface_and_paint_does_not():
    pose = np.eye(4)
    pose[0, 3] = 0.3
    for shine, moves in ((0.0, False), (0.7, True)):
        here, there = (trace_mesh(glossy(corner_normals(), shine), at, INTRINSICS, SIZE)[0] for at in (np.eye(4), pose))
        assert (abs(here.max() - there.max()) > 1e-3) == moves


@pytest.mark.parametrize(
    "change",
    [
        {"normals": np.zeros((2, 3, 3))},
        {"shine": np.array([-0.1])},
        {"shine": np.array([np.nan])},
        {"exponent": 0.5},
        {"towards_light": np.array([0.0, 0, 2])},
    ],
)
def test_highlights_without_meaning_are_refused(change):
    parts = {"normals": np.zeros((1, 3, 3)), "shine": np.array([0.5]), "exponent": 2.0, "towards_light": LIGHT}
    with pytest.raises(InputError, match="highlights"):
        Gloss(**(parts | change))


def test_highlights_of_other_triangles_are_refused():
    two = Gloss(np.zeros((2, 3, 3)), np.zeros(2), 2.0, LIGHT)
    with pytest.raises(InputError, match="highlights of 2 triangles on 1"):
        replace(mesh(SLANTED, np.zeros((1, 1, 3))), gloss=two)
