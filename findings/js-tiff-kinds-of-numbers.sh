#!/usr/bin/env bash
# A good guess: the npm package tiff, with which image-js reads TIFFs in a browser, reads numbers as the file says that they are, or refuses
# what it does not know, as it does whole numbers of 32 bits. Found: negative readings of 16 bits come as 65536 more, half-precision numbers as
# the integers with the same bits (1.5 is 15872), and of a picture in colour that is cut into tiles only its first pixel is right: the
# rest are other colours of other places. All without a word; grey tiles and single precision are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check tifffile==2026.3.3 numpy==2.4.6
npm install --silent --no-fund --no-audit tiff@7.1.3 > npm.log 2>&1
v/bin/python - <<'PY'
import numpy as np
import tifffile

rows, columns = np.mgrid[:32, :32]
tifffile.imwrite("signed.tif", np.full((4, 4), -12, np.int16))
tifffile.imwrite("half.tif", np.full((4, 4), 1.5, np.float16))
tifffile.imwrite("single.tif", np.full((4, 4), 1.5, np.float32))
tifffile.imwrite("grey tiles.tif", (8 * columns).astype(np.uint8), tile=(16, 16))
tifffile.imwrite("colour tiles.tif", np.stack([8 * columns] * 3, -1).astype(np.uint8), tile=(16, 16), photometric="rgb")
PY
cat > read.mjs <<'JS'
import { readFileSync } from 'node:fs'
import { decode } from 'tiff'
const read = (name) => decode(readFileSync(name))[0].data
const right = (name, channels) =>
  read(name).reduce((sum, value, index) => sum + (value === 8 * (Math.floor(index / channels) % 32)), 0)
const found = [read('signed.tif')[0], read('half.tif')[0], read('single.tif')[0], right('grey tiles.tif', 1) / 1024, right('colour tiles.tif', 3) / 3072]
console.log('tiff', JSON.parse(readFileSync('node_modules/tiff/package.json')).version,
  `-12 is ${found[0]}, 1.5 in half precision ${found[1]}, in single ${found[2]}; right in grey tiles ${100 * found[3]} %, in coloured ones ${(100 * found[4]).toFixed(1)} %`)
if (found[0] !== 65524 || found[1] !== 15872 || found[2] !== 1.5 || found[3] !== 1 || found[4] > 0.1) {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node read.mjs
