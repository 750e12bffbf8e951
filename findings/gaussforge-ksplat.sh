#!/usr/bin/env bash
# A good guess: GaussForge, whose page lists KSPLAT, exchanges such files with the viewer GaussianSplats3D, which made the format. Found: the
# viewer opens GaussForge's files as scenes of no splats (their header leaves the number of sections at 0), without an error. GaussForge reads the
# viewer's uncompressed files with red's, green's and blue's harmonics mixed from the second degree on (the viewer keeps each degree by itself), and
# of those at its levels of compression 1 and 2 other places: sixteen-bit numbers are taken for floats. Its own round trip hides it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gaussforge==0.6.0 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit @mkkellogg/gaussian-splats-3d@0.4.7 three@0.180.0 > npm.log 2>&1
cat > make.py <<'PY'
from pathlib import Path

import gaussforge
import numpy as np

names = "x y z f_dc_0 f_dc_1 f_dc_2".split() + [f"f_rest_{i}" for i in range(24)]
names += "opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
count = 600
table = np.zeros((count, len(names)), "<f4")
table[:, :3] = np.random.default_rng(0).uniform(-2, 2, (count, 3))
table[:, 6:30] = np.arange(1, 25)  # f_rest_i is i + 1
table[:, 30:35] = [2, -3, -3, -3, 1]
header = "".join(f"property float {name}\n" for name in names)
head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{header}end_header\n"
Path("scene.ply").write_bytes(head.encode() + table.tobytes())
made = gaussforge.GaussForge().convert(Path("scene.ply").read_bytes(), "ply", "ksplat")
Path("by-forge.ksplat").write_bytes(made["data"])
PY
cat > view.mjs <<'JS'
import fs from 'node:fs'
import { KSplatLoader, PlyLoader } from '@mkkellogg/gaussian-splats-3d'
globalThis.window = globalThis
const bytes = (path) => new Uint8Array(fs.readFileSync(path)).buffer
for (const level of [0, 1, 2]) {
  const scene = await PlyLoader.loadFromFileData(bytes('scene.ply'), 0, level, true, 2)
  fs.writeFileSync(`level-${level}.ksplat`, Buffer.from(scene.bufferData))
}
for (const name of ['level-0', 'level-1', 'level-2', 'by-forge']) {
  const scene = await KSplatLoader.loadFromFileData(bytes(`${name}.ksplat`))
  const centres = new Float32Array(3 * scene.getSplatCount())
  scene.fillSplatCenterArray(centres, null, undefined, undefined, 0)
  fs.writeFileSync(`${name}.seen`, Buffer.from(centres.buffer))
  console.log('GaussianSplats3D 0.4.7 sees in', name, scene.getSplatCount(), 'splats')
}
JS
cat > look.py <<'PY'
from pathlib import Path

import gaussforge
import numpy as np

forge = gaussforge.GaussForge()


def read(path):
    answer = forge.convert(Path(path).read_bytes(), "ksplat", "ply")
    if "error" in answer:
        return None
    head, body = answer["data"].split(b"end_header\n", 1)
    have = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property")]
    table = np.frombuffer(body, "<f4").reshape(-1, len(have))
    return {name: table[:, have.index(name)] for name in have}


def off(level):
    """Return how far GaussForge puts the worst splat from the nearest that the viewer sees: infinite if it reads none."""
    seen = np.fromfile(f"level-{level}.seen", "<f4").reshape(-1, 3)
    have = read(f"level-{level}.ksplat")
    if have is None:
        return np.inf
    places = np.nan_to_num(np.stack([have[axis] for axis in "xyz"], axis=1).astype(float), nan=1e9)
    return max(np.abs(seen - place).max(axis=1).min() for place in places)


own, plain = read("by-forge.ksplat"), read("level-0.ksplat")
rest = [int(plain[f"f_rest_{i}"][0]) for i in range(24)]
print("gaussforge", gaussforge.__version__, "reads f_rest 1 to 24 of level 0 as", *rest)
print("places off by", *(off(level) for level in range(3)), "at levels 0, 1, 2")
assert [own[f"f_rest_{i}"][0] for i in range(24)] == list(range(1, 25))
for level in range(3):
    assert Path(f"level-{level}.seen").stat().st_size == 600 * 12
assert Path("by-forge.seen").stat().st_size == 0, "the behaviour has changed"
red, green, blue = np.arange(1, 25).reshape(3, 8)
kept = np.concatenate([red[:3], green[:3], blue[:3], red[3:], green[3:], blue[3:]])
assert rest == kept.tolist(), "the behaviour has changed"
assert off(0) < 1e-6 and min(off(1), off(2)) > 0.5, "the behaviour has changed"
PY
v/bin/python make.py
node --no-deprecation view.mjs
v/bin/python look.py
