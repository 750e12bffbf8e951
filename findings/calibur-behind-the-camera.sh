#!/usr/bin/env bash
# A good guess: calibur's ray tracer, made to check cameras against, returns for each pixel the first surface in front of the camera, and the
# distance to it. Found: BVH.raycast takes the surface that lies farthest behind the camera, if there is one, at a negative distance:
# in a room whose walls are 5 m in front and 3 m behind, every pixel has the wall behind, at -3 m, and render() paints it, in
# the direction in which it faces. A scene that lies wholly in front is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check calibur==0.0.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from calibur.raytracing import BVH
from calibur.render_pipelines import SimpleRayTraceRP
from calibur.shading import NormalCaptureEnvironment


def wall(z, half=20.0):
    """Return two triangles of a square wall at z that face the origin."""
    a, b, c, d = ([x * half, y * half, z] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return [[a, c, b], [a, d, c]] if z > 0 else [[a, b, c], [a, c, d]]


forward = np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32)
found = {}
for name, walls in (("in front", (5, 7)), ("in front and behind", (5, -3))):
    triangles = np.array([each for z in walls for each in wall(z)], np.float32)
    hit, distance, _, _ = BVH(triangles).raycast(np.zeros_like(forward), forward)
    camera = dict(fx=8, fy=8, cx=4, cy=4, sx=8, sy=8)
    picture = SimpleRayTraceRP().set_geometry(triangles).render(NormalCaptureEnvironment(), np.eye(4, dtype=np.float32), **camera)
    normal = picture[3, 3] * 2 - 1
    found[name] = [walls[each // 2] for each in hit], distance.tolist(), normal.round(3).tolist(), float(np.ptp(picture, axis=(0, 1)).max())
    print("calibur", version("calibur"), f"walls {name}, z {walls}: hits z {found[name][0]} at {np.round(distance, 3).tolist()}; the picture shows a normal of {found[name][2]}")
hits, distances, normal, spread = found["in front"]
assert hits == [5, 5] and np.allclose(distances, [5, 6.25]) and normal == [0, 0, -1] and spread == 0
hits, distances, normal, spread = found["in front and behind"]
assert hits == [-3, -3] and np.allclose(distances, [-3, -3.75]), "raycast: the behaviour has changed"
assert normal == [0, 0, 1] and spread == 0, "render: the behaviour has changed"
PY
