#!/usr/bin/env bash
# A good guess: loaders.gl, which deck.gl and others read PLY files with, keeps a vertex's colours in the type that the header names, or scales
# them to 8 bits. Found: whatever they are, they are put into bytes as they stand: of 16 bits the lower byte is left, so that 65535 is white
# and 32768 black, and of floats from 0 to 1 the whole part, so that all but pure colours are black. Both are marked as normalised.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit @loaders.gl/core@4.4.5 @loaders.gl/ply@4.4.5 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { readFileSync } from 'node:fs'
import { parse } from '@loaders.gl/core'
import { PLYLoader } from '@loaders.gl/ply'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const version = JSON.parse(readFileSync('node_modules/@loaders.gl/ply/package.json')).version
const places = ['x', 'y', 'z'].map((name) => `property float ${name}`)
const expected = { uchar: [255, 128, 1], ushort: [255, 0, 1], float: [1, 0, 0] }
const written = { uchar: '255 128 1', ushort: '65535 32768 257', float: '1 0.5 0.004' }
for (const type of Object.keys(expected)) {
  const colours = ['red', 'green', 'blue'].map((name) => `property ${type} ${name}`)
  const head = ['ply', 'format ascii 1.0', 'element vertex 1', ...places, ...colours, 'end_header']
  const file = [...head, `0 0 0 ${written[type]}`, ''].join('\n')
  const { attributes } = await parse(new TextEncoder().encode(file).buffer, PLYLoader, { worker: false })
  const found = Array.from(attributes.COLOR_0.value)
  console.log('loaders.gl', version, `colours of type ${type}, written ${written[type]}, are read as`, found)
  assert(attributes.COLOR_0.value instanceof Uint8Array && attributes.COLOR_0.normalized, 'the behaviour has changed')
  assert.deepStrictEqual(found, expected[type], 'the behaviour has changed')
}
JS
node look.mjs
