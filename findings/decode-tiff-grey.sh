#!/usr/bin/env bash
# A good guess: the npm package decode-tiff, whose page lists grey of 8 bits, gives such pictures grey; and colours of 16 bits by their upper bytes, or
# refuses them, as it refuses grey of 16 bits. Found: a grey pixel's red, green and blue are that pixel and the next two, so that each edge has a coloured
# fringe and rows run into one another. Of 16 bits each byte counts as a colour: red, green and blue of 200, 100 and 50 are the colours 7, 200, 7 and
# 100, 7, 50 by turns (7 are the lower bytes), and the lower half of the picture is missing. Nothing is reported.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check tifffile==2026.3.3 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit decode-tiff@0.2.1 > npm.log 2>&1
cat > make.py <<'PY'
import numpy as np
import tifffile

grey = np.repeat(np.array([[10, 10, 10, 200, 200, 200]], np.uint8), 2, axis=0)
colours = np.zeros((4, 4, 3), np.uint8) + np.array([200, 100, 50], np.uint8)
tifffile.imwrite("grey.tif", grey, photometric="minisblack")
tifffile.imwrite("colours.tif", colours, photometric="rgb")
tifffile.imwrite("colours-16.tif", colours.astype(np.uint16) * 256 + 7, photometric="rgb")
PY
v/bin/python make.py
cat > look.js <<'JS'
const fs = require('fs')
const assert = require('assert')
const { decode } = require('decode-tiff')
const found = {}
for (const name of ['colours', 'grey', 'colours-16']) {
  const { width, height, data } = decode(new Uint8Array(fs.readFileSync(name + '.tif')))
  found[name] = Array.from({ length: width * height }, (_, i) => Array.from(data.slice(4 * i, 4 * i + 3)))
  console.log('decode-tiff 0.2.1,', name, width, 'x', height, JSON.stringify(found[name].slice(0, 12)))
}
assert(found.colours.every((pixel) => String(pixel) === '200,100,50'))
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b)
const grey = same(found.grey.slice(0, 6), [[10, 10, 10], [10, 10, 200], [10, 200, 200], [200, 200, 200], [200, 200, 10], [200, 10, 10]])
const deep = found['colours-16'].every((pixel, i) => String(pixel) === (i % 2 ? '100,7,50' : '7,200,7'))
if (!grey || !deep) throw new Error('the behaviour has changed')
JS
node look.js || exit 1
