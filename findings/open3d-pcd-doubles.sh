#!/usr/bin/env bash
# A good guess: Open3D's read_point_cloud reads what its newer t.io writes. Found: a binary PCD file with coordinates in double precision, which is
# what t.io makes of a float64 array, is read by the older reader as points that all lie at 0, and normals likewise; the same file as text is read
# right. The newer reader keeps one value of each field of several (COUNT 3, as features have): no word of either.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check open3d==0.20.0 numpy==2.4.6
cat > look.py <<'PY'
from pathlib import Path

import numpy as np
import open3d as o3d

points = np.array([[1.5, 2.5, 3.5], [-4.25, 5.25, 6.75]])
cloud = o3d.t.geometry.PointCloud(points)
cloud.point.normals = np.array([[0, 0, 1.0], [0, 1.0, 0]])
print("Open3D", o3d.__version__)
read = {}
for text in (False, True):
    assert o3d.t.io.write_point_cloud("cloud.pcd", cloud, write_ascii=text)
    older, newer = o3d.io.read_point_cloud("cloud.pcd"), o3d.t.io.read_point_cloud("cloud.pcd")
    read[text] = np.asarray(older.points), np.asarray(older.normals), newer.point.positions.numpy()
    print("as text" if text else "binary ", "older reader", read[text][0].tolist(), "newer", read[text][2].tolist())
head = "FIELDS x y z feature\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 3\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA binary\n"
Path("three.pcd").write_bytes(b"VERSION 0.7\n" + head.encode() + np.array([1, 2, 3, 10, 20, 30], "<f4").tobytes())
feature = o3d.t.io.read_point_cloud("three.pcd").point["feature"].numpy()
print("a field of 10, 20, 30:", feature.tolist())
assert all(np.array_equal(values, points) for values in (read[True][0], read[True][2], read[False][2]))
assert not read[False][0].any() and read[False][0].shape == (2, 3), "the behaviour has changed"
assert not read[False][1].any(), "the behaviour has changed"
assert feature.tolist() == [[10]], "the behaviour has changed"
PY
v/bin/python look.py
