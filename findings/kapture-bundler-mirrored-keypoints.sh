#!/usr/bin/env bash
# A good guess: kapture's import of a Bundler file gives cameras, points and keypoints that fit together. Found: Bundler's keypoints, which count y upwards
# from the picture's centre, are moved to its corner and not turned over: each comes out mirrored at the middle row, while cameras and points are turned
# (about x, by half a turn). A file whose points project to within 0.001 px of its keypoints has errors of up to 437 px then, in a picture of 480 rows.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps kapture==1.1.12 numpy-quaternion==2024.0.13
v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 pillow==13.0.0 piexif==1.1.3 tqdm==4.70.1 numba==0.68.1
cat > look.py <<'PY'
import subprocess
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0
# Bundler's camera: x right, y up, looking along -z; keypoints from the centre, y up.
turn = Rotation.from_euler("xyz", [0.1, -0.05, 0.03]).as_matrix()
shift = np.array([0.1, 0.2, -6.0])
points = np.array([[x, y, z] for x in (-2.0, 1.5) for y in (-2.0, 0.3, 2.0) for z in (-0.5, 0.8)])
seen = points @ turn.T + shift
keypoints = -FOCAL * seen[:, :2] / seen[:, 2:]
assert np.all(np.abs(keypoints) < [WIDTH / 2, HEIGHT / 2])
pixels = keypoints * [1, -1] + [WIDTH / 2, HEIGHT / 2]  # y down, from the corner

rows = lambda table: [" ".join(repr(float(number)) for number in row) for row in table]
lines = ["# Bundle file v0.3", f"2 {len(points)}"]
for _ in range(2):
    lines += [f"{FOCAL} 0 0", *rows(turn), *rows([shift])]
for i, point in enumerate(points):
    lines += [*rows([point]), "255 255 255", " ".join(["2"] + [f"{camera} {i} {float(keypoints[i][0])!r} {float(keypoints[i][1])!r}" for camera in (0, 1)])]
Path("bundle.out").write_text("\n".join(lines) + "\n")
Path("list.txt").write_text("a.png\nb.png\n")
Path("pictures").mkdir()
for name in ("a.png", "b.png"):
    Image.new("RGB", (WIDTH, HEIGHT)).save(Path("pictures", name))
command = "v/bin/kapture_import_bundler -i bundle.out -l list.txt -im pictures -o kept -f --add-reconstruction"
subprocess.run(command.split(), check=True)


def table(path):
    return [line.replace(",", " ").split() for line in Path("kept", path).read_text().splitlines() if not line.startswith("#")]


pose = np.array(table("sensors/trajectories.txt")[0][2:], float)  # qw qx qy qz and the shift, from the world to the camera, y down
kept = np.array(table("reconstruction/points3d.txt"), float)[:, :3]
in_camera = kept @ Rotation.from_quat(np.roll(pose[:4], -1)).as_matrix().T + pose[4:]
projected = FOCAL * in_camera[:, :2] / in_camera[:, 2:] + [WIDTH / 2, HEIGHT / 2]
found = np.fromfile("kept/reconstruction/keypoints/sift/a.png.kpt", np.float32).reshape(-1, 2)
errors = np.abs(projected - found).max(axis=1)
print("kapture", version("kapture"), "points project to within", np.abs(projected - pixels).max().round(6), "px of where they were seen")
print("keypoints are off by", errors.min().round(1), "to", errors.max().round(1), "px; mirrored, by", np.abs(found * [1, -1] + [0, HEIGHT] - pixels).max().round(4))
assert np.abs(projected - pixels).max() < 1e-3
assert np.allclose(kept, points * [1, -1, -1], atol=1e-6), "the behaviour has changed"
assert np.abs(found * [1, -1] + [0, HEIGHT] - pixels).max() < 1e-3, "the behaviour has changed"
assert errors.max() > 300, "the behaviour has changed"
PY
v/bin/python look.py
