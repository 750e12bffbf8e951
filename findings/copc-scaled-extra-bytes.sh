#!/usr/bin/env bash
# A good guess: copc.js, which viewers read LAS and COPC clouds with, gives extra dimensions of points in their units, as LAS describes them by a
# scale and an offset. Found: it reads the two as big-endian numbers, while all else in LAS is little-endian: heights above ground of
# 12.34 m, stored as 1234 and a scale of 0.01, become 9.5e287 m, and the offset of 100 m is 1e-319 m. The description is read 100 bytes before
# its place and is empty.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit copc@0.0.8 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { createRequire } from 'node:module'
import { readFileSync } from 'node:fs'
const { Las } = createRequire(import.meta.url)('copc')
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

// What a LAS file says of one extra dimension: signed, 16 bits, with a scale and perhaps an offset.
function described(name, scale, offset) {
  const entry = new Uint8Array(192)
  const view = new DataView(entry.buffer)
  view.setUint8(2, 4)
  view.setUint8(3, offset === undefined ? 8 : 8 | 16)
  entry.set(new TextEncoder().encode(name), 4)
  view.setFloat64(112, scale, true)
  view.setFloat64(136, offset ?? 0, true)
  entry.set(new TextEncoder().encode('metres above ground'), 160)
  return entry
}
const extras = Las.ExtraBytes.parse(new Uint8Array([...described('Height', 0.01), ...described('Other', 0.01, 100)]))
const point = new Uint8Array(24) // of format 0, with two extra dimensions
new DataView(point.buffer).setInt16(20, 1234, true)
new DataView(point.buffer).setInt16(22, 1234, true)
const header = { pointDataRecordFormat: 0, pointDataRecordLength: 24, scale: [0.001, 0.001, 0.001], offset: [0, 0, 0] }
const view = Las.View.create(point, header, extras)
const height = view.getter('Height')(0)
const other = view.getter('Other')(0)
const { version } = JSON.parse(readFileSync('node_modules/copc/package.json'))
console.log(`copc.js ${version}: 12.34 m is ${height}, 112.34 m is ${other},`, extras)
function reversed(number) {
  const both = new DataView(new ArrayBuffer(8))
  both.setFloat64(0, number, true)
  return both.getFloat64(0)
}
assert.strictEqual(height, 1234 * reversed(0.01), 'the behaviour has changed')
assert.strictEqual(other, 1234 * reversed(0.01) + reversed(100), 'the behaviour has changed')
assert(height > 1e280 && extras[1].offset < 1e-300, 'the behaviour has changed')
assert.strictEqual(extras[0].description, '', 'the behaviour has changed')
JS
node look.mjs
