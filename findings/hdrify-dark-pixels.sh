#!/usr/bin/env bash
# A good guess: an HDR picture that the npm package hdrify writes as Radiance (.hdr) keeps dark pixels as well as bright ones, to 1 %: that is what
# the exponent of each pixel is for. Found: hdrify writes none below 128 (2 to the power of 0), so that below 0.5 all pixels share steps of 1/255:
# 0.032 is 0.033, and whatever lies below 0.0039 comes back as 0.00196, in OpenCV as black. OpenCV's own files keep 0.00003, and hdrify reads them right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit hdrify@1.2.1 > npm.log 2>&1
cat > make.py <<'PY'
import cv2
import numpy as np

light = 10.0 ** -np.arange(0, 5, 0.5)
cv2.imwrite("by-opencv.hdr", np.repeat(light[None, :, None], 3, axis=2).astype(np.float32), [cv2.IMWRITE_HDR_COMPRESSION, cv2.IMWRITE_HDR_COMPRESSION_NONE])
np.array(light, "<f4").tofile("light.raw")
PY
v/bin/python make.py
cat > write.mjs <<'JS'
import fs from 'node:fs'
import { readHdr, writeHdr } from 'hdrify'
const bytes = (path) => new Uint8Array(fs.readFileSync(path))
const light = new Float32Array(bytes('light.raw').buffer)
const data = new Float32Array(4 * light.length)
light.forEach((value, i) => data.set([value, value, value, 1], 4 * i))
fs.writeFileSync('by-hdrify.hdr', writeHdr({ width: light.length, height: 1, data, linearColorSpace: 'linear-rec709', metadata: {} }))
for (const name of ['by-hdrify', 'by-opencv']) {
  const read = readHdr(bytes(name + '.hdr')).data
  fs.writeFileSync(name + '.raw', Buffer.from(Float32Array.from(light, (_, i) => read[4 * i]).buffer))
}
JS
node write.mjs
cat > look.py <<'PY'
import cv2
import numpy as np

light = np.fromfile("light.raw", "<f4")
found = {(by, "hdrify"): np.fromfile(f"by-{by}.raw", "<f4") for by in ("hdrify", "opencv")}
found |= {(by, "opencv"): cv2.imread(f"by-{by}.hdr", cv2.IMREAD_UNCHANGED)[0, :, 0] for by in ("hdrify", "opencv")}
for (by, reader), values in found.items():
    print(f"hdrify 1.2.1, opencv {cv2.__version__}: of", light.astype(float).round(6).tolist(), f"a file by {by} has, by {reader}'s reader,", values.astype(float).round(6).tolist())
assert np.allclose(found["opencv", "opencv"], light, rtol=0.01)
assert np.allclose(found["opencv", "hdrify"], light * 256 / 255, rtol=0.01)
assert np.allclose(found["hdrify", "hdrify"][:4], light[:4], rtol=0.06)
for reader in ("hdrify", "opencv"):
    dark = found["hdrify", reader][light < 0.0039]
    assert len(dark) == 5 and np.ptp(dark) == 0, "the behaviour has changed"
assert np.allclose(found["hdrify", "hdrify"][light < 0.0039], 0.5 / 255), "the behaviour has changed"
PY
v/bin/python look.py
