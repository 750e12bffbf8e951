#!/usr/bin/env bash
# A good guess: the npm package las-reader, which streams LAS files, gives the fields of a point as they were written. Found: only places and, in old
# formats, sources are right. Intensities have their bytes exchanged (258 is 513, 1000 is 59395), class 2 (ground) is 32 and 6 (building) 96, return 1 of
# 3 is 0 of 6, an angle of -12 degrees is 244. In points of format 6, of LAS 1.4, all classes are 0, the class is given as the angle, and the angle as
# the source. Nothing is reported.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check laspy==2.7.0 numpy==2.4.6
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit las-reader@1.0.19 > npm.log 2>&1
cat > make.py <<'PY'
import laspy
import numpy as np

for number in (0, 6):
    header = laspy.LasHeader(point_format=number, version="1.4" if number else "1.2")
    header.scales, header.offsets = [0.01] * 3, [0, 0, 0]
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.tile([[1.0, 2, 3], [4, 5, 6]], (10, 1)).T
    cloud.intensity = [258, 1000] * 10
    cloud.return_number, cloud.number_of_returns = [1, 2] * 10, [3] * 20
    cloud.classification = [2, 6] * 10
    if number:
        cloud.scan_angle = [-2000, 2000] * 10
    else:
        cloud.scan_angle_rank = [-12, 12] * 10
    cloud.point_source_id = [77, 78] * 10
    cloud.write(f"format-{number}.las")
PY
v/bin/python make.py
cat > look.js <<'JS'
const fs = require('fs')
const assert = require('assert')
const { LasStreamReader } = require('las-reader')
const read = (name) => new Promise((done, failed) => {
  const points = []
  const reader = new LasStreamReader({ ignore_projection: true, transform_lnglat: false })
  reader.on('data', (records) => points.push(...records)).on('end', () => done(points)).on('error', failed)
  reader.end(new Uint8Array(fs.readFileSync(name)))
})
const field = (points, name) => points.map((point) => point[name])
const main = async () => {
  for (const number of [0, 6]) {
    const points = await read(`format-${number}.las`)
    assert.strictEqual(points.length, 20)
    const found = {}
    const names = ['intensity', 'classification', 'return_number', 'number_of_returns', 'scan_angle_rank', 'point_source_id']
    for (const name of ['scaled', ...names]) found[name] = field(points.slice(0, 2), name)
    console.log('las-reader 1.0.19, points of format', number, JSON.stringify(found))
    assert.deepStrictEqual(found.scaled, [[1, 2, 3], [4, 5, 6]])
    const expected = number ? [[513, 59395], [0, 0], [1, 1], [12, 12], [2, 6], [63536, 2000]] : [[513, 59395], [32, 96], [0, 0], [6, 6], [244, 12], [77, 78]]
    if (JSON.stringify(names.map((name) => found[name])) !== JSON.stringify(expected)) throw new Error('the behaviour has changed')
  }
}
main().catch((problem) => { console.error(problem); process.exit(1) })
JS
node look.js
