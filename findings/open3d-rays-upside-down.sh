#!/usr/bin/env bash
# A good guess: `up` of Open3D's create_rays_pinhole() points up in the picture, and depth that is cast along its rays becomes the same surface by
# Open3D's create_from_depth_image(). Found: `up` points down: a camera that looks along -z with y as `up` sees what is up in its lowest
# row, and what is right on its left. And rays go through pixels' centres at 0.5, where clouds of depth have them at whole numbers:
# each surface moves by half a pixel up and left.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check open3d==0.20.0 numpy==2.4.6
v/bin/python - <<'PY'
import numpy as np
import open3d as o3d
import open3d.core as o3c

RaycastingScene = o3d.t.geometry.RaycastingScene
looking = RaycastingScene.create_rays_pinhole(fov_deg=90, center=[0, 0, 0], eye=[0, 0, 5], up=[0, 1, 0], width_px=8, height_px=6).numpy()
first = looking[0, 0, 3:]
print("Open3D", o3d.__version__, "looking along -z, y up: the ray of the upper left pixel", first)
assert np.allclose(first, [0.875, -0.625, -1]), "up: the behaviour has changed"

intrinsics = np.array([[4.0, 0, 4], [0, 4, 3], [0, 0, 1]])
wall = o3d.t.geometry.TriangleMesh(
    o3c.Tensor(np.float32([[-9, -9, 2], [9, -9, 2], [9, 9, 2], [-9, 9, 2]])), o3c.Tensor(np.int64([[0, 1, 2], [0, 2, 3]]))
)
scene = RaycastingScene()
scene.add_triangles(wall)
rays = scene.create_rays_pinhole(o3c.Tensor(intrinsics), o3c.Tensor(np.eye(4)), 8, 6)
hit = rays.numpy()[..., :3] + rays.numpy()[..., 3:] * scene.cast_rays(rays)["t_hit"].numpy()[..., None]
depth = o3d.t.geometry.Image(o3c.Tensor(np.ascontiguousarray(hit[..., 2])))
cloud = o3d.t.geometry.PointCloud.create_from_depth_image(depth, o3c.Tensor(intrinsics), depth_scale=1.0)
points = cloud.point.positions.numpy()  # in the order in which threads end
back = points[np.lexsort(points[:, :2].T.round(3))].reshape(6, 8, 3)
moved = (back - hit)[..., :2] * 4 / 2  # pixels at a depth of 2 and a focal length of 4
print("cast at", hit[0, 0], "of its depth", back[0, 0], "pixels between", moved[0, 0])
assert np.allclose(moved, -0.5), "half a pixel: the behaviour has changed"
PY
