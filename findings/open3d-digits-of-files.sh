#!/usr/bin/env bash
# A good guess: Open3D, whose clouds are in double precision, writes them so, or as text with the digits that they need. Found, for points 4,000 km from the
# origin as surveyors have them: PLY as text has six digits (all points within 10 m become one), from both of its interfaces; binary PCD is in single
# precision from the older one; and PTS from the newer one holds other numbers, the doubles' bytes taken for floats. Binary PLY and XYZ are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check open3d==0.20.0 numpy==2.4.6
cat > look.py <<'PY'
import numpy as np
import open3d as o3d

points = np.array([[4_000_000.123, 550_000.456, 100.789], [4_000_003.223, 550_001.556, 101.889]])
older = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
newer = o3d.t.geometry.PointCloud(points)
off = {}


def kept(path):
    if path.endswith(".pts"):
        return np.loadtxt(path, skiprows=1)[:, :3]
    if path.endswith(".xyz"):
        return np.loadtxt(path)
    return o3d.t.io.read_point_cloud(path).point.positions.numpy()


for name, text in (("ply", False), ("ply", True), ("pcd", False), ("pcd", True), ("xyz", True), ("pts", True)):
    if name != "pts":
        assert o3d.io.write_point_cloud(f"older.{name}", older, write_ascii=text)
        off["older", name, text] = float(np.abs(kept(f"older.{name}") - points).max())
    if name != "xyz":
        assert o3d.t.io.write_point_cloud(f"newer.{name}", newer, write_ascii=text)
        off["newer", name, text] = float(np.abs(kept(f"newer.{name}") - points).max())
print("Open3D", o3d.__version__, "largest errors, in metres")
for (interface, name, text), error in off.items():
    print(f"{interface} interface, {name} {'as text' if text else 'binary'}: {error:.3g}")
right = [off[key] for key in (("older", "ply", False), ("newer", "ply", False), ("newer", "pcd", False), ("older", "xyz", True))]
assert max(right) < 1e-6
assert all(1 < off[interface, "ply", True] < 10 for interface in ("older", "newer")), "the behaviour has changed"
assert 0.05 < off["older", "pcd", False] < 0.3, "the behaviour has changed"
assert off["newer", "pts", True] > 1000, "the behaviour has changed"
PY
v/bin/python look.py
