"""The motorcycle: its geometry against the second photograph, its views against holes and against the first."""

import dataclasses

import cv2
import numpy as np
import pytest
from skimage import data

from gs2ci.core.errors import InputError
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Timing
from gs2ci_sims.scenes.rgbd import DisparityPhoto, completed, motorcycle_photo, seen_at


def seen_by(scene, photograph, principal_shift_px):
    """Resample a full-size photograph to the scene's camera, averaging over pixels, [H, W, 3]."""
    source = motorcycle_photo().intrinsics.copy()
    source[0, 2] += principal_shift_px
    fine = 4
    target = scene.intrinsics * np.array([[fine], [fine], [1.0]])
    matrix = (target @ np.linalg.inv(source))[:2]
    matrix[:, 2] += 0.5 * np.diag(matrix) - 0.5  # OpenCV counts from the first pixel's centre
    height, width = scene.size
    large = cv2.warpAffine(photograph / 255.0, matrix, (width * fine, height * fine))
    return large.reshape(height, fine, width, fine, 3).mean(axis=(1, 3))


def psnr(error):
    return -10 * np.log10(np.mean(error**2))


def test_a_points_disparity_is_where_the_second_camera_sees_it():
    photo = motorcycle_photo()
    disparity, x = 40.0, 300.0
    depth = 1 / photo.inverse_depth(np.array(disparity))
    across = (x - photo.intrinsics[0, 2]) / photo.intrinsics[0, 0] * depth
    seen = (across - photo.baseline_m) / depth * photo.intrinsics[0, 0] + photo.intrinsics[0, 2]
    assert seen + photo.principal_offset_px == pytest.approx(x - disparity)


def test_the_motorcycle_stands_two_to_five_metres_away(motorcycle_scene):
    near, far = np.nanmin(motorcycle_scene.depth), np.nanmax(motorcycle_scene.depth)
    assert 2.0 < near < 2.2
    assert 4.8 < far < 5.2
    assert near < motorcycle_scene.median_depth < far
    assert motorcycle_scene.depth.shape == motorcycle_scene.size == (272, 400)


def test_from_the_first_camera_the_scene_looks_like_the_photograph(motorcycle_scene):
    view, coverage = Renderer().views(motorcycle_scene, np.eye(4)[None])
    error = view[0] - seen_by(motorcycle_scene, data.stereo_motorcycle()[0], 0.0)
    assert psnr(error) > 27
    assert np.median(np.abs(error)) < 0.012
    assert coverage.min() > 0.99


def test_from_the_second_camera_it_looks_like_the_photograph_taken_there(motorcycle_scene):
    photo = motorcycle_photo()
    scale = motorcycle_scene.intrinsics[0, 0] / photo.intrinsics[0, 0]
    intrinsics = motorcycle_scene.intrinsics.copy()
    intrinsics[0, 2] += scale * photo.principal_offset_px
    there = dataclasses.replace(motorcycle_scene, intrinsics=intrinsics)
    pose = StageMove((photo.baseline_m, 0, 0)).world_to_camera(np.ones(1))
    view, coverage = Renderer().views(there, pose)
    second = seen_by(there, data.stereo_motorcycle()[1], photo.principal_offset_px)
    error = (view[0] - second)[coverage[0] > 0.99]
    assert len(error) > 0.95 * coverage.size
    assert np.median(np.abs(error)) < 0.02
    assert psnr(error) > 23


def test_no_view_of_the_demonstrations_move_has_holes(motorcycle_scene):
    timing = Timing()
    path = stage_move_for_parallax(motorcycle_scene, 12.0, timing.duration_s(8))
    poses = path.world_to_camera(np.linspace(-0.5, 0.5, 5) * timing.duration_s(8))
    _, coverage = Renderer().views(motorcycle_scene, poses)
    assert (coverage >= 0.99).mean(axis=(1, 2)).min() >= 0.995
    assert (coverage >= 0.9).mean(axis=(1, 2)).min() >= 0.9995


def test_moved_by_half_the_stereo_baseline_hardly_a_pixel_is_missing(motorcycle_scene):
    poses = StageMove((0.0965, 0, 0)).world_to_camera(np.array([-1.0, 1.0]))
    _, coverage = Renderer().views(motorcycle_scene, poses)
    inner = coverage[:, :, 40:-40]  # beyond the photograph's own border there is nothing to see
    assert (inner >= 0.9).mean() > 0.998


def test_the_scene_is_the_same_every_time(motorcycle_scene):
    again = seen_at((272, 400), *completed(motorcycle_photo()))
    for name, tensor in again.gaussians.parameters().items():
        assert np.array_equal(tensor, motorcycle_scene.gaussians.parameters()[name]), name


def small_photo(**changes):
    rng = np.random.default_rng(0)
    disparity = np.full((30, 40), 5.0)
    disparity[10:20, 15:25] = 12.0
    fields = {
        "name": "drawn",
        "colour": rng.uniform(0, 1, (30, 40, 3)),
        "disparity_px": disparity,
        "intrinsics": np.array([[50.0, 0, 20], [0, 50.0, 15], [0, 0, 1]]),
        "baseline_m": 0.1,
    }
    return DisparityPhoto(**{**fields, **changes})


@pytest.mark.parametrize("size", [(20, 30), (60, 60), (7, 200), (1, 1)])
def test_a_camera_of_any_size_looks_at_the_middle_and_sees_no_hole(size):
    scene = seen_at(size, *completed(small_photo()))
    _, coverage = Renderer().views(scene, np.eye(4)[None])
    assert scene.size == size
    assert coverage.min() > 0.94  # up to six times the photograph's own resolution
    assert scene.depth.max() <= 1.0 + 1e-9
    corner = np.linalg.inv(scene.intrinsics) @ [0, 0, 1]
    assert (np.abs(corner[:2]) <= [0.4, 0.3]).all()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"colour": np.zeros((30, 40))}, "disparity"),
        ({"colour": np.full((30, 40, 3), 2.0)}, "outside"),
        ({"colour": np.full((30, 40, 3), np.nan)}, "outside"),
        ({"disparity_px": np.full((30, 40), np.nan)}, "give no depth"),
        ({"disparity_px": np.full((30, 40), -1.0)}, "give no depth"),
        ({"baseline_m": 0.0}, "give no depth"),
        ({"intrinsics": np.zeros((3, 3))}, "intrinsics"),
    ],
)
def test_photographs_that_give_no_scene_are_refused(changes, problem):
    with pytest.raises(InputError, match=problem):
        small_photo(**changes)
