"""What hides what: the evidence in a scene of two textured planes, its depth reversal, and degenerate scenes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gs2ci.core.lens import slopes_of, undistorted
from gs2ci.reconstruct.geometry.depth.occlusion import (
    Occlusion,
    doubted_things,
    occlusion,
    preferred,
    things,
)
from gs2ci.reconstruct.geometry.path.motion import reversed_poses

SIZE = (48, 64)
FOCAL_PX = 120.0
CAMERA = np.array([[FOCAL_PX, 0, 32], [0, FOCAL_PX, 24], [0, 0, 1]])
WIDE = np.array([[40.0, 0, 32], [0, 40, 24], [0, 0, 1]])
BACKDROP, PANEL = 4.0, 2.0
HALF_PANEL = 0.22
ABOUT = np.diag([-1.0, 1, -1, 1])
BARREL = np.array([-0.4, 0.1, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def scene():
    """Views of a textured panel before a textured backdrop, [5, 48, 64, 1], their depths and poses."""
    return drawn()


def drawn(camera=CAMERA, distortion=None):
    wider = FOCAL_PX / camera[0, 0]  # everything so many times larger
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = np.linspace(-0.103, 0.097, 5) * wider
    rng = np.random.default_rng(5)
    walls = [gaussian_filter(rng.standard_normal((400, 400)), 2.5) for _ in range(2)]
    walls = [0.5 + 0.2 * wall / wall.std() for wall in walls]
    down, right = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    slopes = slopes_of(np.stack([right, down], axis=-1), camera)
    if distortion is not None:
        slopes = undistorted(slopes, distortion)
    views, depths = [], []
    for pose in poses:
        at = [slopes * depth - pose[:2, 3] for depth in (PANEL, BACKDROP)]
        on_panel = (np.abs(at[0]) < HALF_PANEL * wider).all(axis=-1)
        colours = [
            map_coordinates(wall, np.moveaxis(place[..., ::-1], -1, 0) * 60 / wider + 200, order=1)
            for wall, place in zip(walls, at, strict=True)
        ]
        views.append(np.where(on_panel, *colours))
        depths.append(np.where(on_panel, PANEL, BACKDROP))
    return np.float32(views)[..., None], np.float32(depths), poses


def reversal(depths, poses):
    c = 1 / PANEL + 1 / BACKDROP
    return np.float32(1 / (c - 1 / depths)), reversed_poses(poses, c)


def test_views_show_the_nearer_surface_of_the_right_scene_and_the_farther_one_of_its_reversal(scene):
    views, depths, poses = scene
    right = occlusion(views, depths, poses, CAMERA)
    turned = occlusion(views, *reversal(depths, poses), CAMERA)
    assert right.total > 0
    assert turned.total == pytest.approx(-right.total, rel=0.3)  # the same places, with near and far exchanged
    told = preferred(right, turned)
    assert told.first
    assert told.times == np.inf
    assert told.errors > 2
    assert not preferred(turned, right).first


def test_the_evidence_does_not_depend_on_the_unit_of_length(scene):
    views, depths, poses = scene
    scaled = poses.copy()
    scaled[:, :3, 3] *= 1024
    here, there = occlusion(views, depths, poses, CAMERA), occlusion(views, depths * 1024, scaled, CAMERA)
    np.testing.assert_allclose(there.evidence, here.evidence, rtol=1e-5, atol=1e-6)


def test_a_lens_bends_the_lines_of_sight():
    views, depths, poses = drawn(WIDE, BARREL)
    through = occlusion(views, depths, poses, WIDE, BARREL)
    assert through.total > 0
    assert occlusion(views, depths, poses, WIDE).total < 0.8 * through.total


def test_colours_count_together(scene):
    views, depths, poses = scene
    one = occlusion(views, depths, poses, CAMERA)
    three = occlusion(np.repeat(views, 3, axis=-1), depths, poses, CAMERA)
    np.testing.assert_allclose(three.evidence, 3 * one.evidence)
    assert three.variance == pytest.approx(3 * one.variance)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda views, depths, poses: (views, depths, np.tile(np.eye(4), (5, 1, 1))), "a camera at rest"),
        (lambda views, depths, poses: (views, np.full_like(depths, 3.0), poses), "one depth"),
        (lambda views, depths, poses: (views, np.zeros_like(depths), poses), "no depth"),
        (lambda views, depths, poses: (views[:1], depths[:1], poses[:1]), "one view"),
        (lambda views, depths, poses: (views[:2], depths[:2], np.stack([poses[0], ABOUT @ poses[1]])), "all behind"),
        (lambda views, depths, poses: (np.full_like(views, 0.5), depths, poses), "an even grey"),
    ],
)
def test_nothing_is_told_where_nothing_hides_anything(scene, change, why):
    found = occlusion(*change(*scene), CAMERA)
    assert found.total == 0, why
    assert preferred(found, found) is None


BLOCKS = np.full((6, 8), 0.02)
CLEAR = Occlusion(BLOCKS, 100.0)


@pytest.mark.parametrize(
    ("other", "why"),
    [
        (replace(CLEAR, evidence=0.6 * BLOCKS), "less than twice as much"),
        (replace(CLEAR, evidence=BLOCKS), "as much"),
        (Occlusion(np.where(np.arange(48).reshape(6, 8) < 23, 0.045, 0.0), 100.0), "more in half of the blocks"),
    ],
)
def test_orders_shown_about_as_clearly_are_left_open(other, why):
    assert preferred(CLEAR, other) is None, why
    assert preferred(other, CLEAR) is None, why


def test_little_evidence_is_none():
    nothing = replace(CLEAR, evidence=0 * BLOCKS)
    assert preferred(CLEAR, nothing).first
    assert preferred(replace(CLEAR, variance=1e5), replace(nothing, variance=1e5)) is None


@pytest.mark.parametrize(("blocks", "enough"), [(3, False), (5, True)])
def test_few_blocks_do_not_tell(blocks, enough):
    some = np.zeros(48)
    some[:blocks] = 0.1
    told = preferred(replace(CLEAR, evidence=some.reshape(6, 8)), replace(CLEAR, evidence=np.zeros((6, 8))))
    assert (told is not None) is enough
    if enough:
        assert told.errors == pytest.approx(blocks**0.5)


def test_one_block_does_not_outvote_all_others():
    """A single thing at the border, or a wrong depth there, may have more contrast than all the rest."""
    alone = np.zeros((6, 8))
    alone[2, 3] = 3.0
    assert preferred(CLEAR, replace(CLEAR, evidence=alone)) is None


TWO_THINGS = np.zeros((6, 8))
TWO_THINGS[1:3, 1:3] = TWO_THINGS[3, 3] = TWO_THINGS[1:5, 6] = 1.0
SHOWS_TWO, SHOWS_NONE = replace(CLEAR, evidence=TWO_THINGS), replace(CLEAR, evidence=0 * TWO_THINGS)
LEFT = np.where(np.arange(8) < 5, TWO_THINGS, 0) > 0


def test_neighbouring_blocks_are_one_thing_across_corners_too():
    found = things(SHOWS_TWO, SHOWS_NONE)
    assert found.max() == 2
    np.testing.assert_array_equal(found == 1, LEFT)
    np.testing.assert_array_equal(things(SHOWS_NONE, SHOWS_TWO), found)
    assert not things(SHOWS_TWO, SHOWS_TWO).any()


def test_a_thing_of_which_a_part_is_doubted_is_doubted_as_a_whole():
    doubted = np.zeros((48, 64), bool)
    assert not doubted_things(things(SHOWS_TWO, SHOWS_NONE), doubted).any()
    doubted[8:12, 8:12] = doubted[40:] = True
    found = doubted_things(things(SHOWS_TWO, SHOWS_NONE), doubted)
    np.testing.assert_array_equal(found, LEFT)
    assert SHOWS_TWO.without(found).total == 4
    assert SHOWS_TWO.without(found).variance == SHOWS_TWO.variance
