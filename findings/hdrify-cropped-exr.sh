#!/usr/bin/env bash
# A good guess: the npm package hdrify reads OpenEXR files whose data window does not begin at 0, as renderers write cropped and overscanned pictures,
# and gives the window's rows. Found: it puts rows where the window lies but is as high as the window: of six rows from row 2 on two are black and the
# last two are missing, of six from row -2 on the first two are. Negative values, as of depth and normals, and infinite ones are 0. three's parser,
# published as parse-exr, reads all of these right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check openexr==3.5.3 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit hdrify@1.2.1 parse-exr@1.0.2 > npm.log 2>&1
cat > make.py <<'PY'
import numpy as np
import OpenEXR

values = np.arange(1, 7, dtype=np.float32)[:, None] * np.ones(8, np.float32)
for packing, code in (("none", OpenEXR.NO_COMPRESSION), ("zip", OpenEXR.ZIP_COMPRESSION)):
    for first in (0, 2, -2):
        header = {
            "compression": code,
            "type": OpenEXR.scanlineimage,
            "dataWindow": (np.array([0, first], np.int32), np.array([7, first + 5], np.int32)),
            "displayWindow": (np.array([0, 0], np.int32), np.array([7, 7], np.int32)),
        }
        OpenEXR.File(header, {name: values.copy() for name in "RGB"}).write(f"{packing}{first}.exr")
signed = {name: np.full((6, 8), value, np.float32) for name, value in (("R", -0.5), ("G", 0.5), ("B", np.inf))}
OpenEXR.File({"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}, signed).write("signed.exr")
PY
v/bin/python make.py
cat > look.mjs <<'JS'
import assert from 'node:assert'
import fs from 'node:fs'
import { readExr } from 'hdrify'
import parseExr from 'parse-exr'
const bytes = (path) => new Uint8Array(fs.readFileSync(path))
const found = {}
for (const packing of ['none', 'zip']) {
  for (const first of packing === 'none' ? [0, 2, -2] : [0, 2]) {
    const name = packing + first
    const rows = ({ data, height }) => Array.from({ length: height }, (_, y) => data[32 * y])
    const three = rows(parseExr(bytes(name + '.exr').buffer, 1015)).reverse()
    found[name] = [rows(readExr(bytes(name + '.exr'))), three].map((each) => JSON.stringify(each))
    console.log('hdrify 1.2.1, rows of 1 to 6, the first at', first, packing, found[name][0], 'by parse-exr', found[name][1])
  }
}
const signed = Array.from(readExr(bytes('signed.exr')).data.slice(0, 3))
console.log('hdrify: -0.5, 0.5 and infinity are', signed)
const check = (good) => { if (!good) throw new Error('the behaviour has changed') }
const whole = '[1,2,3,4,5,6]'
for (const [own, other] of Object.values(found)) assert.strictEqual(other, whole)
assert.deepStrictEqual([found.none0[0], found.zip0[0]], [whole, whole])
check(found.none2[0] === '[0,0,1,2,3,4]' && found.zip2[0] === '[0,0,1,2,3,4]' && found['none-2'][0] === '[3,4,5,6,0,0]')
check(String(signed) === '0,0.5,0')
JS
node look.mjs || exit 1
