import torch

from gs2ci.render import se3
from gs2ci.render.camera import pixel_rays, project_points, scale_intrinsics, unproject

INTRINSICS = torch.tensor([[30.0, 0, 7.3], [0, 28.0, 4.9], [0, 0, 1]], dtype=torch.float64)
POSE = se3.exp(torch.tensor([0.2, -0.1, 0.4, 0.05, -0.3, 0.1], dtype=torch.float64))


def test_ray_of_the_first_pixel_goes_through_its_centre():
    rays = pixel_rays(INTRINSICS, (8, 13))
    assert rays.shape == (8, 13, 3)
    torch.testing.assert_close(rays[0, 0], torch.tensor([(0.5 - 7.3) / 30, (0.5 - 4.9) / 28, 1], dtype=torch.float64))


def test_projection_undoes_unprojection():
    depth = torch.rand(8, 13, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) + 1
    pixels, depths = project_points(unproject(depth, INTRINSICS, POSE), INTRINSICS, POSE)
    torch.testing.assert_close(depths, depth)
    torch.testing.assert_close(pixels[3, 5], torch.tensor([5.5, 3.5], dtype=torch.float64))
    torch.testing.assert_close(pixels[..., 1], (torch.arange(8.0).double() + 0.5)[:, None].expand(8, 13))


def test_points_project_into_many_cameras_at_once():
    points = torch.tensor([[0.0, 0, 3], [0.5, -0.2, 4]], dtype=torch.float64)
    poses = torch.stack([torch.eye(4, dtype=torch.float64), POSE])
    pixels, depths = project_points(points, INTRINSICS, poses[:, None])
    assert pixels.shape == (2, 2, 2)
    alone, depth = project_points(points, INTRINSICS, POSE)
    torch.testing.assert_close(pixels[1], alone)
    torch.testing.assert_close(depths[1], depth)


def test_scaled_camera_sees_the_same_view_at_another_resolution():
    point = torch.tensor([0.3, -0.2, 2.0], dtype=torch.float64)
    pixel, _ = project_points(point, INTRINSICS, POSE)
    for scale_x, scale_y in ((0.5, None), (2.0, 0.25)):
        scaled, _ = project_points(point, scale_intrinsics(INTRINSICS, scale_x, scale_y), POSE)
        factors = torch.tensor([scale_x, scale_x if scale_y is None else scale_y], dtype=torch.float64)
        torch.testing.assert_close(scaled, pixel * factors)
