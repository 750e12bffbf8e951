#!/usr/bin/env bash
# A good guess: 3dgs-edit-tools' CSV of a scene, converted back, is the scene, and its point cloud has the splats' colours, 0.5 + 0.282 f_dc. Found:
# colours go into the CSV file stretched from the scene's lowest to its highest coefficient, and come back from -3 to 3, whatever they were:
# grey becomes black. In the point cloud they are stretched as well: a grey scene is black, a pale one has black and full colours.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check 3dgs-edit-tools==0.3.0 open3d==0.20.0 pandas==3.1.1 matplotlib==3.11.2 numpy==2.4.6
v/bin/python - <<'PY'
import contextlib
import io
import multiprocessing
from importlib.metadata import version

import numpy as np
import src as tools  # the package's own name

NAMES = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
KINDS = {"float": "<f4", "uchar": "u1"}


def run(name, *files):
    """Run one of its conversions as a process of its own, as its commands are."""

    def convert():
        with contextlib.redirect_stdout(io.StringIO()):
            getattr(tools, name)(*files)

    process = multiprocessing.get_context("fork").Process(target=convert)
    process.start()
    process.join()
    assert process.exitcode == 0


def write(path, colours):
    """Write splats of such base coefficients."""
    splats = np.zeros(len(colours), [(name, "<f4") for name in NAMES])
    splats["x"], splats["rot_0"] = np.arange(len(colours)), 1
    for axis in range(3):
        splats[f"f_dc_{axis}"] = np.array(colours)[:, axis]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(colours)}", *(f"property float {name}" for name in NAMES), "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(head).encode() + splats.tobytes())


def read(path, names):
    """Return the named properties of a binary PLY file's points."""
    head, data = open(path, "rb").read().split(b"end_header\n", 1)
    fields = [line.split()[1:] for line in head.decode().splitlines() if line.startswith("property")]
    points = np.frombuffer(data, [(name, KINDS[kind]) for kind, name in fields])
    return np.stack([points[name].astype(float) for name in names], axis=-1).round(2)


found = {}
for label, colours in (("grey", [[0, 0, 0], [0, 0, 0]]), ("pale", [[0.2, 0.5, 0.8], [0.1, 0.4, 0.4]])):
    write("scene.ply", colours)
    run("convert_3dgs_to_csv", "scene.ply", "scene.csv")
    run("convert_csv_to_3dgs", "scene.csv", None, "back.ply")
    run("convert_3dgs_to_pointcloud", "scene.ply", "cloud.ply")
    found[label] = read("back.ply", NAMES[3:6]).tolist(), read("cloud.ply", ["red", "green", "blue"]).tolist()
    right = (255 * (0.5 + 0.28209479 * np.array(colours))).round().tolist()
    print("3dgs-edit-tools", version("3dgs-edit-tools"), label, colours, "by CSV:", found[label][0], "; its points:", found[label][1], "instead of", right)
assert found["grey"] == ([[-3, -3, -3]] * 2, [[0, 0, 0]] * 2), "grey: the behaviour has changed"
assert found["pale"] == ([[-1.5, 0.75, 3], [-2.25, 0, 0]], [[36, 145, 255], [0, 109, 109]]), "pale: the behaviour has changed"
PY
