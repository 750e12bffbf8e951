"""Rays through Gaussians against closed forms, to 1e-6."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.rays.gaussians import OPACITY_MIN, trace_gaussians

SIZE = (20, 24)
INTRINSICS = np.array([[30.0, 0, 12.3], [0, 28.0, 9.1], [0, 0, 1]])


def gaussians(means, scales, turns, opacities, colours):
    """Exact float64 Gaussians from rotation vectors and opacities."""
    quaternions = np.roll(Rotation.from_rotvec(turns).as_quat(), 1, axis=1)
    opacities = np.array(opacities)
    columns = (means, np.log(scales), quaternions, np.log(opacities / (1 - opacities)), colours)
    return Gaussians(*(torch.tensor(np.array(column), dtype=torch.float64) for column in columns))


SLANTED = gaussians(
    [[0.1, -0.05, 2.0], [0.15, 0.0, 2.3]],
    [[0.4, 0.1, 0.02], [0.3, 0.3, 0.01]],
    [[0.9, 0.2, -0.3], [-0.4, 0.8, 0.1]],
    [0.9, 0.7],
    [[1.0, 0.2, 0.1], [0.0, 0.5, 1.0]],
)
POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.02, -0.05, 0.1]).as_matrix()
POSE[:3, 3] = [0.05, 0.02, 0.1]


def rays(pose=POSE, intrinsics=INTRINSICS, size=SIZE):
    """Origin [3] and directions [H, W, 3] in world axes; the direction's z in camera axes is 1."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    slopes = [(x - intrinsics[0, 2]) / intrinsics[0, 0], (y - intrinsics[1, 2]) / intrinsics[1, 1], np.ones(size)]
    return -pose[:3, :3].T @ pose[:3, 3], np.stack(slopes, axis=-1) @ pose[:3, :3]


def closed_form(scene, number):
    """Opacity [H, W] and depth of the largest value along each ray, from the covariance's inverse.

    Along o + t d the exponent is a parabola in t: with P the inverse covariance and v = o - mean, it has its minimum at
    t = -(d P v) / (d P d), where it is v P v - (d P v)^2 / (d P d).
    """
    origin, direction = rays()
    axes = Rotation.from_quat(np.roll(scene.quaternions[number].numpy(), -1)).as_matrix()
    precision = axes @ np.diag(np.exp(-2 * scene.log_scales[number].numpy())) @ axes.T
    away = origin - scene.means[number].numpy()
    along = np.einsum("hwi,ij,j->hw", direction, precision, away)
    length = np.einsum("hwi,ij,hwj->hw", direction, precision, direction)
    opacity = 1 / (1 + np.exp(-float(scene.opacity_logits[number])))
    return opacity * np.exp(-0.5 * (away @ precision @ away - along**2 / length)), -along / length


def traced(scene, pose=POSE, intrinsics=INTRINSICS, size=SIZE):
    return trace_gaussians(scene, scene.colours.double().numpy(), pose, intrinsics, size)


@pytest.mark.parametrize("number", [0, 1])
def test_one_slanted_gaussian_is_its_closed_form(number):
    scene = SLANTED.map(lambda tensor: tensor[number : number + 1])
    opacity, depth = closed_form(SLANTED, number)
    radiance, coverage, weighted = traced(scene)
    seen = opacity > 1e-9
    assert seen.mean() > 0.2
    assert coverage[seen] == pytest.approx(opacity[seen], rel=1e-6)
    assert weighted[seen] == pytest.approx((opacity * depth)[seen], rel=1e-6)
    assert radiance[seen] == pytest.approx(opacity[seen, None] * scene.colours.numpy(), rel=1e-6)


def test_two_slanted_gaussians_are_blended_in_the_order_that_each_ray_meets_them():
    (first, near), (second, far) = (closed_form(SLANTED, number) for number in (0, 1))
    colours = SLANTED.colours.numpy()
    swapped = near > far
    assert 0.05 < swapped.mean() < 0.95  # they pass through each other: no order of centres is right
    front, behind = np.where(swapped, second, first), np.where(swapped, first, second)
    tint = np.where(swapped[..., None], colours[1], colours[0])
    other = np.where(swapped[..., None], colours[0], colours[1])
    expected = front[..., None] * tint + ((1 - front) * behind)[..., None] * other
    radiance, coverage, _ = traced(SLANTED)
    seen = expected.min(axis=2) > 1e-6
    assert seen.mean() > 0.2
    assert radiance[seen] == pytest.approx(expected[seen], rel=1e-6)
    assert coverage == pytest.approx(1 - (1 - first) * (1 - second), rel=1e-6, abs=2 * OPACITY_MIN)


def test_a_round_gaussian_on_the_axis_falls_off_with_the_angle_to_its_centre():
    """Distance of the ray at angle a from a centre at depth z is z sin a: exp(-(z sin a)^2 / (2 s^2))."""
    scene = gaussians([[0, 0, 3.0]], [[0.2] * 3], [[0, 0, 0]], [0.8], [[1, 1, 1]])
    _, coverage, _ = traced(scene, pose=np.eye(4))
    _, direction = rays(pose=np.eye(4))
    sine2 = 1 - 1 / np.square(direction).sum(axis=-1)
    expected = 0.8 * np.exp(-9 * sine2 / (2 * 0.04))
    assert coverage[expected > 1e-9] == pytest.approx(expected[expected > 1e-9], rel=1e-6)


def test_far_smaller_than_a_pixel_the_gaussian_is_still_there_where_the_ray_passes():
    scene = gaussians([[0, 0, 3.0]], [[1e-6] * 3], [[0, 0, 0]], [0.8], [[1, 1, 1]])
    centred = INTRINSICS.copy()
    centred[:2, 2] = [12.5, 9.5]  # the ray through pixel (9, 12) meets the centre
    _, coverage, _ = traced(scene, pose=np.eye(4), intrinsics=centred)
    assert coverage[9, 12] == pytest.approx(0.8, rel=1e-6)
    assert coverage.sum() == pytest.approx(0.8, rel=1e-6)


def test_what_lies_behind_the_camera_is_not_seen():
    behind = SLANTED.map(torch.clone)
    behind.means[:, 2] -= 10.0
    assert not any(image.any() for image in traced(behind))


def test_no_gaussians_give_a_dark_image():
    radiance, coverage, _ = traced(SLANTED.map(lambda tensor: tensor[:0]))
    assert radiance.shape == (*SIZE, 3)
    assert not radiance.any()
    assert not coverage.any()


def test_lists_by_tile_leave_out_nothing_that_matters():
    """Hundreds of Gaussians of all sizes, some around the camera, against every Gaussian for every ray."""
    rng = np.random.default_rng(0)
    count = 300
    scene = gaussians(
        rng.normal(0, 1.5, (count, 3)),
        np.exp(rng.uniform(-6, 1, (count, 3))),
        rng.normal(size=(count, 3)),
        rng.uniform(0.01, 0.99, count),
        rng.random((count, 3)),
    )
    coverage = traced(scene)[1]
    through = np.ones(SIZE)
    for number in range(count):
        opacity, depth = closed_form(scene, number)
        through *= 1 - np.where(depth > 0, opacity, 0.0)
    assert coverage == pytest.approx(1 - through, abs=2 * count * OPACITY_MIN + 1e-9)


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30])
def test_scales_out_of_all_proportion_stay_finite(scale):
    scene = gaussians([[0, 0, 3.0]], [[scale, 0.1, 0.1]], [[0.1, 0.2, 0.3]], [0.8], [[1, 1, 1]])
    assert all(np.isfinite(image).all() for image in traced(scene))
