"""Meshes of depths whose surface is known, read by trimesh."""

import numpy as np
import pytest
import trimesh

from gs2ci.core.errors import InputError
from gs2ci.evaluate.exports.mesh import fuse, without_crumbs, write_mesh
from gs2ci.evaluate.points import Cameras

SIZE, FOCAL_PX, RADIUS = (72, 72), 90.0, 1.0
INTRINSICS = np.array([[FOCAL_PX, 0, 36], [0, FOCAL_PX, 36], [0, 0, 1.0]])


def looking_at_the_origin(eyes):
    """World-to-camera poses at places, [N, 4, 4]."""
    poses = []
    for eye in eyes:
        ahead = -eye / np.linalg.norm(eye)
        up = np.array([0.0, 1, 0]) if abs(ahead[1]) < 0.9 else np.array([0.0, 0, 1])
        right = np.cross(up, ahead) / np.linalg.norm(np.cross(up, ahead))
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        pose[:3, 3] = -pose[:3, :3] @ eye
        poses.append(pose)
    return np.stack(poses)


def depth_of_a_sphere(cameras):
    """Exact depth of the unit sphere at the origin, [N, H, W]; 0 beside it."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    rays = cameras.rays(np.stack([columns, rows], -1))
    found = []
    for pose in cameras.world_to_camera:
        centre = pose[:3, 3]
        a, b = (rays**2).sum(-1), rays @ centre
        root = b**2 - a * (centre @ centre - RADIUS**2)
        found.append(np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0))
    return np.stack(found).astype(np.float32)


@pytest.fixture(scope="module")
def all_around():
    eyes = 3.0 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    eyes = np.concatenate([eyes, 3.0 / 3**0.5 * np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, 8).T])
    return Cameras(looking_at_the_origin(eyes), INTRINSICS)


def test_a_sphere_seen_from_all_around_is_closed_and_round(all_around, tmp_path):
    depth = depth_of_a_sphere(all_around)
    views = np.broadcast_to(np.float32([0.2, 0.5, 0.8]), (*depth.shape, 3))
    made = trimesh.load(write_mesh(tmp_path / "m.ply", fuse(depth, views, all_around, voxels=40)))
    assert made.is_watertight
    assert made.is_winding_consistent
    assert made.volume == pytest.approx(4 / 3 * np.pi, rel=0.05)  # positive: faces look outwards
    np.testing.assert_allclose(np.linalg.norm(made.vertices, axis=1), RADIUS, atol=0.06)
    colours = made.visual.vertex_colors[:, :3] / 255
    np.testing.assert_allclose(np.median(colours, axis=0), [0.2, 0.5, 0.8], atol=0.01)


def test_what_one_camera_sees_is_open_and_lies_where_it_is(all_around):
    front = Cameras(all_around.world_to_camera[:1], INTRINSICS)
    depth = depth_of_a_sphere(front)
    views = np.full((*depth.shape, 1), 0.5, np.float32)
    made = fuse(depth, views, front, voxels=40)
    shape = trimesh.Trimesh(made.vertices, made.faces, process=False)
    assert not shape.is_watertight
    assert made.vertices[:, 0].min() > -0.2  # the camera stands at +x
    np.testing.assert_allclose(np.linalg.norm(made.vertices, axis=1), RADIUS, atol=0.1)


def test_a_lens_is_followed(all_around):
    bent = Cameras(all_around.world_to_camera, INTRINSICS, np.array([-0.2, 0.05, 0, 0, 0.0]))
    depth = depth_of_a_sphere(bent)
    made = fuse(depth, np.ones((*depth.shape, 3), np.float32), bent, voxels=32)
    np.testing.assert_allclose(np.linalg.norm(made.vertices, axis=1), RADIUS, atol=0.08)


def test_what_cannot_be_believed_is_left_out_and_nothing_is_refused(all_around):
    depth = depth_of_a_sphere(all_around)
    views = np.ones((*depth.shape, 3), np.float32)
    doubtful = np.zeros_like(depth)
    with pytest.raises(InputError, match=r"no depth of this run is reliable.*depth_confidence"):
        fuse(depth, views, all_around, doubtful)
    with pytest.raises(InputError, match="--voxels 4"):
        fuse(depth, views, all_around, voxels=4)
    with pytest.raises(InputError, match="--least-share 2"):
        fuse(depth, views, all_around, least_share=2)
    doubtful[0] = 1
    assert fuse(depth, views, all_around, doubtful, voxels=24).vertices[:, 0].min() > -0.4
    single = np.zeros_like(depth)
    single[0, 10, 10] = single[0, 60, 60] = 2.0
    with pytest.raises(InputError, match="make no surface"):
        fuse(single, views, all_around, voxels=8)


def test_nothing_far_outside_the_frame_is_seen_through_a_lens_whose_polynomial_folds():
    """A wall at 4 before one camera, and one before another in the same place that is turned to the side by 63°."""
    lens, matrix = np.array([-0.2, 0, 0, 0, 0.0]), np.array([[40.0, 0, 24], [0, 40.0, 24], [0, 0, 1]])
    turn = np.radians(63)
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
    depth = np.full((2, 48, 48), 4, np.float32)
    made = fuse(depth, np.full((*depth.shape, 1), 0.5, np.float32), Cameras(poses, matrix, lens), voxels=64)
    for pose in poses:
        local = made.vertices @ pose[:3, :3].T
        ahead = (np.abs(local[:, :2]) < 1.2).all(axis=1) & (local[:, 2] > 0)
        # Marching cubes make a few vertices for each step of a tenth.
        assert ahead.sum() > 300
        np.testing.assert_allclose(local[ahead, 2], 4, atol=0.15)


def test_a_crumb_that_touches_a_piece_in_one_corner_is_left_out():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [-0.01, 0, 0], [0, -0.01, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2], [0, 4, 5]])
    kept_vertices, kept = without_crumbs(vertices, faces, 0.01)
    assert kept.tolist() == faces[:2].tolist()
    np.testing.assert_array_equal(kept_vertices, vertices[:4])


def test_pieces_that_hang_together_with_nothing_are_left_out():
    """Of the demonstration's 266 pieces 192 had fewer than ten faces."""
    large = trimesh.creation.icosphere(3, radius=1.0)
    crumbs = [trimesh.creation.box((0.04,) * 3).apply_translation((2 + 0.1 * k, 0, 0)) for k in range(30)]
    medium = trimesh.creation.box((0.3,) * 3).apply_translation((0, 3, 0))
    whole = trimesh.util.concatenate([*crumbs, large, medium])
    vertices, faces = without_crumbs(np.array(whole.vertices), np.array(whole.faces), 0.01)
    kept = trimesh.Trimesh(vertices, faces, process=False)
    assert sorted(round(piece.area, 6) for piece in kept.split()) == sorted(
        round(piece.area, 6) for piece in (medium, large)
    )
    for share, pieces in ((0.0, 32), (1.0, 1)):
        assert trimesh.Trimesh(*without_crumbs(whole.vertices, whole.faces, share)).body_count == pieces
