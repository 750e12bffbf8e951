#!/usr/bin/env bash
# A good guess: three.js's PLYLoader keeps the 8-bit colours of a cloud of points as they are, and its renderer makes light of them. Found:
# it turns them into linear light and stores that in 8 bits again, in which the dark have hardly any levels: the 64 greys from 0 to 63 become
# 14, all greys up to 6 are black, and of 256 greys 183 are left. Colours written as floats lose nothing.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit three@0.187.0 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { REVISION } from 'three'
import { PLYLoader } from 'three/examples/jsm/loaders/PLYLoader.js'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const greys = Array.from({ length: 256 }, (_, grey) => grey)
function read(type, values) {
  const places = ['x', 'y', 'z'].map((name) => `property float ${name}`)
  const colours = ['red', 'green', 'blue'].map((name) => `property ${type} ${name}`)
  const head = ['ply', 'format ascii 1.0', `element vertex ${values.length}`, ...places, ...colours, 'end_header']
  const file = [...head, ...values.map((value) => `0 0 0 ${value} ${value} ${value}`), ''].join('\n')
  const { color } = new PLYLoader().parse(new TextEncoder().encode(file).buffer).attributes
  return { array: color.array, red: values.map((_, number) => color.array[3 * number]) }
}
const bytes = read('uchar', greys)
const floats = read('float', greys.map((grey) => grey / 255))
const all = new Set(bytes.red).size
const dark = new Set(bytes.red.slice(0, 64)).size
const black = bytes.red.lastIndexOf(0)
console.log(`three r${REVISION}: 256 greys become ${all}, the darkest 64 become ${dark}, greys up to ${black} are black;`)
console.log(`as floats ${new Set(floats.red).size} are left`)
assert(bytes.array instanceof Uint8Array && floats.array instanceof Float32Array, 'the behaviour has changed')
assert(all < 200 && dark < 16 && black >= 4, 'the behaviour has changed')
assert.strictEqual(new Set(floats.red).size, 256, 'the behaviour has changed')
JS
node look.mjs
