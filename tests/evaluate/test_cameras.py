import resource

import numpy as np
import pycolmap
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import StorageError
from gs2ci.core.lens import distorted, pixels_of
from gs2ci.evaluate.cameras import nerfstudio_transforms, write_colmap_model
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
    """pycolmap does not tell: the limit on the size of files is met in the middle of the points."""
    points = np.random.default_rng(0).random((400, 3)).astype(np.float32)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4000, hard))
    try:
        with pytest.raises(StorageError, match=r"points3D\.bin cannot be written: not all of its 400 points"):
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
