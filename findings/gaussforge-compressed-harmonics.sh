#!/usr/bin/env bash
# A good guess: GaussForge's compressed PLY holds the coefficients of harmonics in the order of PLY (all of red, then green, then blue), as
# PlayCanvas has them, whose format it is; it reads PlayCanvas's files so. Found: it writes red, green, blue by turns, into properties of the
# usual names. By its own round trip, or read by splat-transform, colours and directions are mixed up from the first degree on; positions,
# sizes and the colour seen from everywhere are right, so that the scene looks right until one walks around it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gaussforge==0.6.0 numpy==2.4.6
npm install --silent --no-fund --no-audit @playcanvas/splat-transform@2.7.1 > npm.log 2>&1
cat > look.py <<'PY'
import subprocess
from pathlib import Path

import gaussforge
import numpy as np

names = "x y z f_dc_0 f_dc_1 f_dc_2".split() + [f"f_rest_{i}" for i in range(9)]
names += "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
forge = gaussforge.GaussForge()


def columns(data):
    head, body = data.split(b"end_header\n", 1)
    have = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(have))
    return {name: table[:, have.index(name)].round(2) for name in have}


def by_splat_transform(data, kind, wanted):
    Path(f"in.{kind}").write_bytes(data)
    subprocess.run(["node_modules/.bin/splat-transform", "-w", f"in.{kind}", f"out.{wanted}"], check=True, capture_output=True)
    return Path(f"out.{wanted}").read_bytes()


written = [1, 2, 3, -1, -2, -3, 0.5, 1.5, 2.5]
splat = np.array([[0.5, 1, 2, 0.1, 0.2, 0.3, *written, 2, -3, -2, -1, 1, 0, 0, 0]], "<f4")
header = "".join(f"property float {name}\n" for name in names)
ply = f"ply\nformat binary_little_endian 1.0\nelement vertex 1\n{header}end_header\n".encode() + splat.tobytes()
assert forge.read(ply, "ply")["data"]["numPoints"] == 1
packed = forge.convert(ply, "ply", "compressed.ply")["data"]
ways = {
    "GaussForge twice": forge.convert(packed, "compressed.ply", "ply")["data"],
    "GaussForge, then splat-transform": by_splat_transform(packed, "compressed.ply", "ply"),
    "splat-transform, then GaussForge": forge.convert(by_splat_transform(ply, "ply", "compressed.ply"), "compressed.ply", "ply")["data"],
}
found = {}
print("gaussforge", gaussforge.__version__, "of", written)
for way, data in ways.items():
    have = columns(data)
    found[way] = np.array([have[f"f_rest_{i}"][0] for i in range(9)])
    print(f"{way:34}", *found[way], "at", have["x"][0], have["y"][0], have["z"][0])
by_turns = np.reshape(written, (3, 3)).T.ravel()
assert np.allclose(found["GaussForge twice"], by_turns, atol=0.03), "the behaviour has changed"
assert np.allclose(found["GaussForge, then splat-transform"], by_turns, atol=0.03), "the behaviour has changed"
assert np.allclose(found["splat-transform, then GaussForge"], written, atol=0.03), "the behaviour has changed"
PY
v/bin/python look.py
