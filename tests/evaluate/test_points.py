"""Points of surfaces whose places and normals are known."""

import numpy as np
import pytest

from gs2ci.core.lens import distorted, pixels_of, slopes_of
from gs2ci.evaluate.points import Cameras, points_of, write_points

SIZE = (30, 40)
INTRINSICS = np.array([[50.0, 0, 20], [0, 50.0, 15], [0, 0, 1]])
TILT = 0.4  # of a plane z = 3 + TILT x


def poses(count=3):
    found = np.tile(np.eye(4), (count, 1, 1))
    turn = np.array([[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]])
    found[-1, :3, :3] = turn
    found[:, 0, 3] = np.linspace(0, -0.4, count)
    return found


def plane_depth(cameras):
    """Depth of the plane z = 3 + TILT x in each view."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    rays = cameras.rays(np.stack([columns, rows], -1))
    maps = []
    for view, pose in enumerate(cameras.world_to_camera):
        centre = -pose[:3, :3].T @ pose[:3, 3]
        along = cameras.in_world(view, rays, directions=True)
        normal = np.array([-TILT, 0, 1.0])
        maps.append((3 - centre @ normal) / (along @ normal))
    return np.stack(maps).astype(np.float32)


@pytest.mark.parametrize("distortion", [None, np.array([-0.1, 0.02, 0, 0, 0])])
def test_a_planes_points_lie_in_it_and_its_normals_point_at_the_cameras(distortion):
    cameras = Cameras(poses(), INTRINSICS, distortion)
    depth = plane_depth(cameras)
    views = np.random.default_rng(0).random((3, *SIZE, 3)).astype(np.float32)
    found = points_of(depth, np.full_like(depth, 0.9), views, cameras)
    assert len(found.positions) == 3 * (SIZE[0] - 2) * (SIZE[1] - 2)
    np.testing.assert_allclose(found.positions[:, 2], 3 + TILT * found.positions[:, 0], rtol=1e-5)
    normal = np.array([TILT, 0, -1]) / np.hypot(TILT, 1)
    np.testing.assert_allclose(found.normals, np.tile(normal, (len(found.normals), 1)), atol=2e-3)
    np.testing.assert_array_equal(found.colours[: SIZE[1] - 2], views[0, 1, 1:-1])


def test_rays_undo_the_lens():
    distortion = np.array([-0.1, 0.02, 0.001, 0, 0])
    cameras = Cameras(poses(), INTRINSICS, distortion)
    pixels = np.array([[3.0, 4.0], [20.0, 15.0], [39.0, 29.0]])
    rays = cameras.rays(pixels)
    np.testing.assert_allclose(pixels_of(distorted(rays[:, :2], distortion), INTRINSICS), pixels, atol=1e-6)
    np.testing.assert_allclose(Cameras(poses(), INTRINSICS).rays(pixels)[:, :2], slopes_of(pixels, INTRINSICS))


def test_jumps_fog_and_what_is_not_seen_give_no_points():
    cameras = Cameras(np.eye(4)[None], INTRINSICS)
    depth, sure = np.full((1, *SIZE), 2.0, np.float32), np.full((1, *SIZE), 0.9, np.float32)
    depth[0, :, 20:] = 3.0
    depth[0, 10:13, 5:8] = 0.0
    sure[0, 20:22] = 0.2
    found = points_of(depth, sure, np.zeros((1, *SIZE, 1), np.float32), cameras)
    depths = found.positions[:, 2]
    assert set(np.unique(depths)) == {2.0, 3.0}
    jump, hole, fog = 28 * 2, 5 * 5 - 4, 2 * 38 - 4
    assert len(depths) == 28 * 38 - jump - hole - fog
    assert found.colours.shape == (len(depths), 3)


def test_a_picture_too_small_for_neighbours_has_no_points():
    depth = np.ones((1, 2, 9), np.float32)
    found = points_of(depth, depth, np.zeros((1, 2, 9, 3), np.float32), Cameras(poses(1), INTRINSICS))
    assert found.positions.shape == (0, 3)


def test_the_file_reads_back(tmp_path):
    cameras = Cameras(poses(), INTRINSICS)
    depth = plane_depth(cameras)
    found = points_of(depth, np.full_like(depth, 0.8), np.full((3, *SIZE, 3), 0.2, np.float32), cameras)
    data = write_points(tmp_path / "points.ply", found).read_bytes()
    head, _, body = data.partition(b"end_header\n")
    assert f"element vertex {len(found.positions)}".encode() in head
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property")]
    kinds = ["<f4"] * 6 + ["u1"] * 3 + ["<f4"]
    table = np.frombuffer(body, np.dtype(list(zip(names, kinds, strict=True))))
    assert names == ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "confidence"]
    np.testing.assert_array_equal(table["y"], found.positions[:, 1])
    assert (table["green"] == 51).all()
    assert (table["confidence"] == np.float32(0.8)).all()
