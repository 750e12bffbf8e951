#!/usr/bin/env bash
# A good guess: three.js's NRRDLoader reads a volume by the header's `endian: big`, and its matrix from indices to space puts the first voxel at the
# header's `space origin`. Found: the upper bytes are read as the lower ones: 300 is 11265, with no word, in whole numbers and floats; and the matrix has no
# translation: a volume that begins at 10, 20, 30 mm begins at 0. Little-endian values and the directions are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 pynrrd==1.1.3
npm install --silent --no-audit --no-fund three@0.187.0
v/bin/python - <<'PY'
import nrrd
import numpy as np

values = 300 * np.arange(24).reshape(2, 3, 4)
place = {"encoding": "raw", "space": "left-posterior-superior", "space directions": np.diag([0.5, 1, 2]), "space origin": [10, 20, 30]}
for name, kind in (("little", "<i2"), ("big", ">i2"), ("floats", ">f4")):
    nrrd.write(f"{name}.nrrd", values.astype(kind), place)
    assert (nrrd.read(f"{name}.nrrd")[0] == values).all()
    assert (f"endian: {'little' if name == 'little' else 'big'}").encode() in open(f"{name}.nrrd", "rb").read()
PY
cat > read.mjs <<'JS'
import { readFileSync } from "node:fs";
import { REVISION } from "three";
import { NRRDLoader } from "three/examples/jsm/loaders/NRRDLoader.js";
const found = {};
for (const name of ["little", "big", "floats"]) {
  const bytes = readFileSync(`${name}.nrrd`);
  const volume = new NRRDLoader().parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
  const moved = volume.matrix.elements.slice(12, 15);
  const data = Array.from(volume.data);
  found[name] = { data, moved };
  console.log("three.js", REVISION, name, "least and largest", Math.min(...data), Math.max(...data), "origin by the matrix", moved.join(" "), "sorted as 0, 300, 600:", [...data].sort((a, b) => a - b).slice(0, 3).join(" "));
}
const right = Array.from({ length: 24 }, (_, index) => 300 * index).join();
const sorted = (name) => [...found[name].data].sort((a, b) => a - b).join();
if (sorted("little") !== right || sorted("big") === right || !found.big.data.includes(11265) || sorted("floats") === right) {
  console.error("the order of bytes: the behaviour has changed");
  process.exit(1);
}
if (Object.values(found).some((one) => one.moved.some((value) => value !== 0))) {
  console.error("the origin: the behaviour has changed");
  process.exit(1);
}
JS
node read.mjs
