#!/usr/bin/env bash
# A good guess: between two time samples of a USD camera's pose, written as a matrix (xformOp:transform), there are poses, as there are between
# those of xformOp:orient. Found: the matrices' numbers are blended one by one: half-way in a turn of 90 degrees two of the camera's axes are
# 0.71 long, and by the matrix that renderers are given the scene is 0.71 times as high as it should be, and as wide as it should: a point at a
# height of 0.167 is seen at 0.118. In a turn of 10 degrees it is 0.4 %, two pixels at the border of 1080 rows. UsdGeom.Camera.GetCamera hides it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check usd-core==26.11 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pxr import Gf, Usd, UsdGeom

stage = Usd.Stage.CreateInMemory()
up, point = Gf.Vec3d(0, 1, 0), np.array([0.5, 0.5, -3, 1])
found = {}
for degrees in (10, 90):
    for kind in ("transform", "orient"):
        camera = UsdGeom.Camera.Define(stage, f"/{kind}{degrees}")
        if kind == "transform":
            turn = camera.AddTransformOp()
            values = [Gf.Matrix4d().SetRotate(Gf.Rotation(up, each)) for each in (0, degrees)]
        else:
            turn = camera.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
            values = [Gf.Rotation(up, each).GetQuat() for each in (0, degrees)]
        for time, value in zip((0, 10), values):
            turn.Set(value, time)
        half = np.array(Gf.Matrix4d().SetRotate(Gf.Rotation(up, degrees / 2)))
        for time, pose in ((5, half), (10, np.array(Gf.Matrix4d().SetRotate(Gf.Rotation(up, degrees))))):
            matrix = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(camera.GetPrim()))
            view = np.array(camera.GetCamera(time).frustum.ComputeViewMatrix())
            seen = [point @ pose @ each for each in (np.linalg.inv(matrix), view)]
            found[degrees, kind, time] = [(each[:2] / -each[2]).round(4).tolist() for each in seen], np.linalg.norm(matrix[:3, :3], axis=1).round(4).tolist()
            (by_matrix, by_camera), axes = found[degrees, kind, time]
            print("usd-core", version("usd-core"), f"{kind}, {degrees} degrees in 10 frames, frame {time}: axes of length {axes}; a point at [0.1667, 0.1667] is seen at {by_matrix}, by GetCamera at {by_camera}")
right = [0.1667, 0.1667]
assert all(by_camera == right for (_, by_camera), _ in found.values())
assert all(by_matrix == right and axes == [1, 1, 1] for (_, kind, time), ((by_matrix, _), axes) in found.items() if kind == "orient" or time == 10)
half = {degrees: (found[degrees, "transform", 5], np.cos(np.radians(degrees / 2))) for degrees in (10, 90)}
assert all(np.allclose(axes, [short, 1, short], atol=1e-3) for (_, axes), short in half.values()), "the behaviour has changed"
assert all(abs(by_matrix[1] - short / 6) < 1e-3 and by_matrix[1] < 0.1663 for ((by_matrix, _), _), short in half.values()), "the behaviour has changed"
PY
