#!/usr/bin/env bash
# A good guess: what splat-transform 2 made of an SPZ file, version 3 makes of it, too. Found: 2.7 turns SPZ's axes (y up) into those of PLY
# files (y down) when it writes one, 3.7 writes SPZ's numbers as they are: the same command gives a scene upside down to the one before, in
# silence.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
mkdir two three
(cd two && echo '{"private": true}' > package.json && npm install --silent --no-audit --no-fund @playcanvas/splat-transform@2.7.1 @adobe/spz@0.2.3 > npm.log 2>&1)
(cd three && echo '{"private": true}' > package.json && npm install --silent --no-audit --no-fund @playcanvas/splat-transform@3.7.0 > npm.log 2>&1)
cat > two/write.mjs <<'JS'
import { writeFileSync } from 'node:fs'
import load from '@adobe/spz'
const spz = await load()
const cloud = { numPoints: 1, shDegree: 0, antialiased: false, extensions: [], positions: new Float32Array([1, 2, 3]),
  scales: new Float32Array([-2, -3, -4]), rotations: new Float32Array([0, 0, 0, 1]), alphas: new Float32Array([1]),
  colors: new Float32Array([0.5, 0, -0.5]), sh: new Float32Array(0) }
const options = { version: 3, from: spz.CoordinateSystem.RUB, sh1Bits: 5, shRestBits: 4 }
writeFileSync('one.spz', spz.saveSpzToBuffer(cloud, options))
JS
(cd two && node write.mjs)
for version in two three; do node $version/node_modules/@playcanvas/splat-transform/bin/cli.mjs -q -w two/one.spz $version.ply > /dev/null; done
python3 - <<'PY'
import struct
import sys

read = {}
for version in ("two", "three"):
    head, _, data = open(version + ".ply", "rb").read().partition(b"end_header\n")
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property float")]
    values = dict(zip(names, struct.unpack(f"<{len(names)}f", data[: 4 * len(names)])))
    read[version] = tuple(round(values[axis], 2) for axis in "xyz")
print("a Gaussian at (1, 2, 3) of an SPZ file: splat-transform 2.7.1 writes", read["two"], "3.7.0", read["three"])
if read != {"two": (1, -2, -3), "three": (1, 2, 3)}:
    sys.exit("the behaviour has changed")
PY
