#!/usr/bin/env bash
# A good guess: jsfive, which reads HDF5 files in a browser, gives values that were never written the data set's fill value, as HDF5 does.
# Found: chunks that were never written are holes of the array: undefined, and NaN in sums. Of a series of images that ended early, or whose
# empty frames were left out, whoever adds or draws gets nothing.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check h5py==3.16.0 numpy==2.4.6
npm install --silent --no-fund --no-audit jsfive@0.4.2 > npm.log 2>&1
v/bin/python - <<'PY'
import h5py

with h5py.File("frames.h5", "w") as file:
    frames = file.create_dataset("frames", (3, 4), "u2", chunks=(1, 4), fillvalue=7)
    frames[0] = 1
    print("h5py", h5py.__version__, frames[:].tolist())
    assert frames[:].tolist() == [[1] * 4, [7] * 4, [7] * 4]
PY
cat > read.mjs <<'JS'
import { isDeepStrictEqual } from 'node:util'
import { readFileSync } from 'node:fs'
import { File } from 'jsfive'
const bytes = readFileSync('frames.h5')
const frames = new File(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), 'frames.h5').get('frames')
const values = Array.from(frames.value)
console.log('jsfive', JSON.parse(readFileSync('node_modules/jsfive/package.json')).version, frames.shape, values)
if (!isDeepStrictEqual(values, [1, 1, 1, 1, ...Array(8).fill(undefined)])) {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node read.mjs
