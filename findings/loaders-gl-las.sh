#!/usr/bin/env bash
# A good guess: loaders.gl's LASLoader makes bytes of the 16-bit colours that LAS prescribes, and gives the classes of points. Found: it keeps the
# lower byte of each colour unless told `colorDepth`: half red, 32768, is black, 25700 is 100 and 25600 is 0. By 'auto' each 100,000 points decide for
# themselves: those in the shade of a cloud of 16 bits, up to 255, become up to 255 of 255. Class 2, marked as withheld or a key point, is
# class 130 or 66; coordinates of a national grid are single floats, half a metre apart.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit --legacy-peer-deps @loaders.gl/las@4.5.1 @loaders.gl/core@4.5.1 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { parseSync } from '@loaders.gl/core'
import { LASLoader } from '@loaders.gl/las'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

// A LAS 1.2 file of format 2: points are [x in mm, the byte of class and flags, red of 16 bits].
function las(points) {
  const view = new DataView(new ArrayBuffer(227 + 26 * points.length))
  new Uint8Array(view.buffer).set(new TextEncoder().encode('LASF'))
  view.setUint8(24, 1)
  view.setUint8(25, 2)
  view.setUint16(94, 227, true)
  view.setUint32(96, 227, true)
  view.setUint8(104, 2)
  view.setUint16(105, 26, true)
  view.setUint32(107, points.length, true)
  for (const axis of [0, 1, 2]) view.setFloat64(131 + 8 * axis, 0.001, true)
  view.setFloat64(155, 5_500_000, true)
  points.forEach(([x, bits, red], number) => {
    view.setInt32(227 + 26 * number, x, true)
    view.setUint8(227 + 26 * number + 15, bits)
    view.setUint16(227 + 26 * number + 20, red, true)
  })
  return view.buffer
}
const read = (points, options) => parseSync(las(points), LASLoader, { worker: false, las: { ...options } }).attributes
const reds = ({ COLOR_0 }) => Array.from(COLOR_0.value).filter((_, place) => place % 4 === 0)

const four = [[0, 2, 32768], [260, 2 | 128, 25700], [300, 2 | 64, 25600], [740, 2, 65535]]
const found = read(four)
console.log(`LASLoader ${LASLoader.version}: red`, reds(found), 'classes', found.classification.value)
console.log('x', Array.from(found.POSITION.value).filter((_, place) => place % 3 === 0))
assert.deepStrictEqual(reds(found), [0, 100, 0, 255], 'the behaviour has changed')
assert.deepStrictEqual(reds(read(four, { colorDepth: 16 })), [128, 100, 100, 255], 'the behaviour has changed')
assert.deepStrictEqual(Array.from(found.classification.value), [2, 130, 66, 2], 'the behaviour has changed')
assert.deepStrictEqual([0, 3, 6, 9].map((place) => found.POSITION.value[place] - 5_500_000), [0, 0.5, 0.5, 0.5], 'the behaviour has changed')

const shaded = [...Array(100_000).fill([0, 2, 60_000]), ...Array(1_000).fill([0, 2, 200])]
const parts = reds(read(shaded, { colorDepth: 'auto' }))
console.log('auto: red of 60000 and of 200 in the next 100,000 points:', parts[0], parts.at(-1))
assert(parts[0] === 234 && parts.at(-1) === 200, 'the behaviour has changed')
JS
node look.mjs
