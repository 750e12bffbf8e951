import resource

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import StorageError
from gs2ci.core.lens import distorted, pixels_of
from gs2ci.evaluate.cameras import nerfstudio_transforms, ngp_box, split_of, write_colmap_model
from gs2ci.evaluate.whole_folder import view_names

INTRINSICS = np.array([[50.0, 0, 30.5], [0, 52.0, 20.25], [0, 0, 1]])


def random_poses(seed, count=3):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.standard_normal((count, 3))
    return poses


def test_views_are_named_so_that_they_sort():
    names = view_names(64)
    assert names == sorted(names)
    assert names[7] == "view_007.png"


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_point_projects_to_the_same_pixel_through_nerfstudios_cameras(seed):
    poses = random_poses(seed)
    transforms = nerfstudio_transforms(poses, INTRINSICS, (40, 60))
    point = np.array([*np.random.default_rng(seed).standard_normal(3), 1])
    for pose, frame in zip(poses, transforms["frames"], strict=True):
        ours = INTRINSICS @ (pose @ point)[:3]
        x, y, z, _ = np.linalg.inv(frame["transform_matrix"]) @ point
        # OpenGL: the picture is seen along -z, its y axis points up.
        theirs = [
            transforms["fl_x"] * x / -z + transforms["cx"],
            transforms["fl_y"] * -y / -z + transforms["cy"],
        ]
        np.testing.assert_allclose(theirs, ours[:2] / ours[2], rtol=1e-6, atol=1e-6)


def test_a_point_projects_to_the_same_pixel_through_colmaps_cameras(tmp_path):
    poses = random_poses(5)
    ahead = np.array([0.1, -0.2, 2.0, 1.0])
    write_colmap_model(
        tmp_path,
        poses,
        INTRINSICS,
        (40, 60),
        points=np.zeros((1, 3), np.float32),
        colors=np.ones((1, 3), np.float32),
    )
    model = pycolmap.Reconstruction(tmp_path)
    for image_id, pose in enumerate(poses, start=1):
        world = np.linalg.inv(pose) @ ahead
        pixel = INTRINSICS @ ahead[:3]
        assert model.images[image_id].project_point(world[:3]) == pytest.approx(pixel[:2] / pixel[2])


def test_a_lens_is_told_to_both_programs(tmp_path):
    lens = np.array([-0.2, 0.03, 1e-3, -2e-3, 0.01])
    poses, ahead = random_poses(5), np.array([0.3, -0.2, 1.0])
    transforms = nerfstudio_transforms(poses, INTRINSICS, (40, 60), lens)
    assert [transforms[key] for key in ("k1", "k2", "p1", "p2", "k3")] == lens.tolist()
    nothing = np.zeros((0, 3), np.float32)
    write_colmap_model(tmp_path, poses, INTRINSICS, (40, 60), points=nothing, colors=nothing, distortion=lens)
    camera = pycolmap.Reconstruction(tmp_path).cameras[1]
    expected = pixels_of(distorted(ahead[:2], lens), INTRINSICS)
    assert camera.img_from_cam(ahead) == pytest.approx(expected)


def test_a_disk_that_refuses_a_part_of_the_points_is_told(tmp_path):
    """The limit on the size of files is met in the middle of the points."""
    points = np.random.default_rng(0).random((400, 3)).astype(np.float32)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, hard))
    try:
        with pytest.raises(StorageError, match=r"points3D\.bin cannot be written: File too large"):
            write_colmap_model(tmp_path, random_poses(0), INTRINSICS, (40, 60), points=points, colors=points)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    write_colmap_model(tmp_path, random_poses(0), INTRINSICS, (40, 60), points=points, colors=points)
    assert len(pycolmap.Reconstruction(tmp_path).points3D) == 400


def test_colours_are_clamped_and_rounded(tmp_path):
    colors = np.array([[-3.0, 0.5, 7.0]], np.float32)
    write_colmap_model(
        tmp_path, random_poses(0), INTRINSICS, (40, 60), points=np.zeros((1, 3), np.float32), colors=colors
    )
    (point,) = pycolmap.Reconstruction(tmp_path).points3D.values()
    assert point.color.tolist() == [0, 128, 255]


@pytest.mark.parametrize("lens", [None, np.array([-0.1, 0.02, 0, 0, 0.0])])
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e6])
def test_points_are_observed_by_the_views_in_whose_depth_they_lie(tmp_path, lens, unit):
    """Dense stereo finds no pictures to compare without tracks."""
    draws = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, -0.1 * unit, -0.2 * unit]
    points = unit * np.column_stack([draws.uniform(-1.5, 1.5, (200, 2)), np.full(200, 3.0)]).astype(np.float32)
    points[:20, 2] *= 2  # behind the surface
    depth = np.full((3, 40, 60), 3 * unit, np.float32)
    depth[1, :, :30] = 0  # not known there
    colors = np.zeros((200, 3), np.float32)
    told = {"points": points, "colors": colors, "distortion": lens, "depth": depth}
    write_colmap_model(tmp_path, poses, INTRINSICS, (40, 60), **told)
    model = pycolmap.Reconstruction(tmp_path)
    assert model.num_points3D() == 200
    tracks = {index: point.track.elements for index, point in model.points3D.items()}
    assert not any(tracks[index] for index in range(1, 21))
    lengths = {len(track) for track in tracks.values()}
    assert lengths <= {0, 2, 3}
    assert {2, 3} <= lengths
    for index, track in tracks.items():
        for element in track:
            image = model.images[element.image_id]
            observed = image.points2D[element.point2D_idx]
            assert observed.point3D_id == index
            np.testing.assert_allclose(observed.xy, image.project_point(model.points3D[index].xyz), atol=1e-3)
            assert not (element.image_id == 2 and observed.xy[0] < 30)
    assert model.compute_mean_reprojection_error() < 1e-3


@pytest.mark.parametrize("channels", [1, 3])
def test_points_that_views_observe_have_the_colours_of_the_views(tmp_path, channels):
    """By pycolmap 4.2.1 a run's points were 23 of 255 off the pictures: they had the Gaussians' own colours."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = -0.1
    points = np.array([[0, 0, 3], [0.5, 0.2, 3], [0, 0, 9]], np.float32)
    views = np.random.default_rng(0).random((2, 40, 60, channels)).astype(np.float32)
    told = {"points": points, "colors": np.full((3, 3), 0.25, np.float32), "views": views}
    write_colmap_model(tmp_path, poses, INTRINSICS, (40, 60), depth=np.full((2, 40, 60), 3, np.float32), **told)
    model = pycolmap.Reconstruction(tmp_path)
    for index in (1, 2):
        shown = []
        for element in model.points3D[index].track.elements:
            column, row = model.images[element.image_id].points2D[element.point2D_idx].xy.astype(int)
            shown.append(views[element.image_id - 1, row, column])
        assert len(shown) == 2
        np.testing.assert_allclose(model.points3D[index].color, 255 * np.broadcast_to(np.mean(shown, 0), 3), atol=0.51)
    assert model.points3D[3].color.tolist() == [64, 64, 64]


@pytest.mark.parametrize("count", range(1, 40, 3))
def test_every_split_has_views_to_train_with_and_views_to_judge_by(count):
    names = [f"views/view_{index:03d}.png" for index in range(count)]
    split = split_of(names)
    assert split["train_filenames"]
    assert split["val_filenames"] == split["test_filenames"]
    assert len(split["val_filenames"]) >= max(1, count // 8)
    assert set(split["train_filenames"]) | set(split["val_filenames"]) == set(names)


def test_a_box_holds_what_is_not_far_out_and_is_the_next_power_of_two():
    along = np.linspace(-5, 5, 2001)
    points = np.stack([along, 0.1 * along, 0 * along], axis=1)
    box = ngp_box(points, np.eye(4)[None])
    # Of 10 units, the inner 9.6 fill nine tenths of the unit cube.
    assert box["scale"] == pytest.approx(0.9 / 9.6, rel=1e-3)
    assert box["aabb_scale"] == 1
    farther = np.concatenate([points, [[9.0, 0, 0]]])
    assert ngp_box(farther, np.eye(4)[None])["aabb_scale"] == 2


def test_a_box_of_one_place_is_of_some_size():
    box = ngp_box(np.zeros((0, 3)), np.eye(4)[None])
    assert (box["scale"], box["offset"], box["aabb_scale"]) == (1.0, [0.5, 0.5, 0.5], 1)
