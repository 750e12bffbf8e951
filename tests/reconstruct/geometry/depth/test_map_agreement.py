"""How far depth maps agree."""

import cv2
import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth.map_agreement import agreement
from gs2ci.render.conventions import NEAR

SIZE = (40, 56)
INTRINSICS = np.array([[60.0, 0, 28], [0, 60.0, 20], [0, 0, 1]])


def path(views, extent=0.4):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -np.linspace(-extent / 2, extent / 2, views)
    return poses


def test_maps_that_contradict_each_other_are_not_believed():
    poses, flat = path(3), np.full((3, *SIZE), 0.5, np.float32)
    inside = np.s_[:, :, 14:-14]
    assert agreement(flat, poses, INTRINSICS, 24.0)[inside].min() == 1
    flat[1] = 0.8
    mixed = agreement(flat, poses, INTRINSICS, 24.0)
    assert mixed[1][:, 14:-14].max() == 0
    assert mixed[0][:, 14:-14].mean() == pytest.approx((0.5 - 0.3) / 0.5)
    assert not agreement(flat[:1], poses[:1], INTRINSICS, 24.0).any()


def in_words(inverse_depth, world_to_camera, intrinsics, parallax_px):
    """The same by points in space, map by map, in float64."""
    count, height, width = inverse_depth.shape
    rows, columns = np.mgrid[:height, :width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(intrinsics).T
    trust = np.zeros(inverse_depth.shape)
    for k in range(count):
        agreeing, seeing = np.zeros((height, width)), np.zeros((height, width))
        for other in set(range(count)) - {k}:
            moved = world_to_camera[other] @ np.linalg.inv(world_to_camera[k])
            points = rays / inverse_depth[k][..., None].astype(float) @ moved[:3, :3].T + moved[:3, 3]
            ahead = points[..., 2] * inverse_depth[k] > NEAR
            at = points @ intrinsics.T
            column, row = (np.floor(at[..., axis] / np.where(ahead, at[..., 2], 1)) for axis in (0, 1))
            inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
            shown = inverse_depth[other][np.where(inside, row, 0).astype(int), np.where(inside, column, 0).astype(int)]
            seeing += inside
            agreeing += inside & (np.abs(shown - 1 / np.where(ahead, points[..., 2], 1)) * parallax_px < 1.5)
        trust[k] = np.where(seeing > 0, np.clip((agreeing / np.maximum(seeing, 1) - 0.3) / 0.5, 0, 1), 0)
    return trust


def test_it_is_that_of_points_in_space():
    """On maps of noise from turned cameras; a few places that lie on the border between two pixels may differ."""
    rng = np.random.default_rng(0)
    maps = (0.5 + 0.03 * rng.normal(size=(5, *SIZE))).astype(np.float32)
    poses = path(5)
    for pose in poses:
        pose[:3, :3] = cv2.Rodrigues(0.05 * rng.normal(size=3))[0]
    found, expected = agreement(maps, poses, INTRINSICS, 24.0), in_words(maps, poses, INTRINSICS, 24.0)
    assert 0.1 < expected.mean() < 0.9
    assert (np.abs(found - expected) > 1e-6).mean() < 1e-3


def test_what_lies_behind_another_camera_is_not_seen_by_it():
    poses = path(2)
    poses[1, :3, :3] = np.diag([-1.0, 1.0, -1.0])
    assert not agreement(np.full((2, *SIZE), 0.5, np.float32), poses, INTRINSICS, 24.0).any()
