#!/usr/bin/env bash
# A good guess: a system of axes named to Adobe's SPZ library by three letters has them along these directions: in RFD, z points down. Found:
# of the sixteen twelve are so; RFD and RBU, and LFD and LBU, are exchanged: both axes but the first point the other way, and a file
# saved "from" one of them is upside down for everybody else.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit @adobe/spz@0.2.3 > npm.log 2>&1
cat > look.mjs <<'JS'
import { readFileSync } from 'node:fs'
import load from '@adobe/spz'
const said = console.log
console.log = () => {} // the library tells what it reads
const spz = await load()
const parts = { R: 1, L: -1, U: 2, D: -2, B: 3, F: -3 } // of the point that lies 1 to the right, 2 up, 3 back
const wrong = []
let right = 0
for (const [name, code] of Object.entries(spz.CoordinateSystem)) {
  if (!/^[LRUDFB]{3}$/.test(name)) continue
  const cloud = { numPoints: 1, shDegree: 0, antialiased: false, extensions: [], positions: new Float32Array([1, 2, 3]),
    scales: new Float32Array(3), rotations: new Float32Array([0, 0, 0, 1]), alphas: new Float32Array(1),
    colors: new Float32Array(3), sh: new Float32Array(0) }
  const bytes = spz.saveSpzToBuffer(cloud, { version: 3, from: spz.CoordinateSystem.RUB, sh1Bits: 5, shRestBits: 4 })
  const found = Array.from(spz.loadSpzFromBuffer(bytes, { to: code }).positions, Math.round)
  const named = [...name].map((letter) => parts[letter])
  if (String(found) === String(named)) right += 1
  else wrong.push(`${name} ${found} instead of ${named}`)
}
said('@adobe/spz', JSON.parse(readFileSync('node_modules/@adobe/spz/package.json')).version, right, 'right;', wrong.sort().join('; '))
const expected = ['LBU -1,-3,-2 instead of -1,3,2', 'LFD -1,3,2 instead of -1,-3,-2', 'RBU 1,-3,-2 instead of 1,3,2', 'RFD 1,3,2 instead of 1,-3,-2']
if (right !== 12 || String(wrong) !== String(expected)) {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node look.mjs
