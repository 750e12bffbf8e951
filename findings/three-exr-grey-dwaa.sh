#!/usr/bin/env bash
# A good guess: three.js' EXRLoader, which reads DWAA and DWAB in colour and in half precision, reads a grey picture of them in single precision too.
# Found: it takes the halves that these compressions decode for the lower bytes of single-precision numbers: 4.8 becomes 2.5e-41, a black
# picture, without a word. Colour in single precision, and grey compressed by PIZ, are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check OpenEXR==3.5.3 numpy==2.4.6
npm install --silent --no-fund --no-audit three@0.187.0 > npm.log 2>&1
v/bin/python - <<'PY'
import numpy as np
import OpenEXR

kinds = {"dwaa": OpenEXR.DWAA_COMPRESSION, "dwab": OpenEXR.DWAB_COMPRESSION, "piz": OpenEXR.PIZ_COMPRESSION}
for name, compression in kinds.items():
    for channels, shape in (("Y", (20, 24)), ("RGB", (20, 24, 3))):
        for kind in (np.float16, np.float32):
            header = {"compression": compression, "type": OpenEXR.scanlineimage}
            file = f"{name} {channels} {np.dtype(kind).itemsize}.exr"
            OpenEXR.File(header, {channels: np.full(shape, 4.8, kind)}).write(file)
PY
cat > read.mjs <<'JS'
import { readdirSync, readFileSync } from 'node:fs'
import { FloatType, REVISION } from 'three'
import { EXRLoader } from 'three/examples/jsm/loaders/EXRLoader.js'
const black = []
for (const name of readdirSync('.').filter((name) => name.endsWith('.exr')).sort()) {
  const bytes = readFileSync(name)
  const loader = new EXRLoader()
  loader.setDataType(FloatType)
  const value = loader.parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length)).data[0]
  console.log('three', REVISION, name, value)
  if (value > 0 && value < 1e-30) black.push(name)
  else if (Math.abs(value - 4.8) > 0.05) black.push(`otherwise: ${name}`)
}
if (black.join() !== 'dwaa Y 4.exr,dwab Y 4.exr') {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node read.mjs
