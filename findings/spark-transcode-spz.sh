#!/usr/bin/env bash
# A good guess: Spark's transcodeSpz(), given a `transform`, makes an SPZ file of the whole scene turned, with the antialiasing flag unset for a PLY file that knows none. Found: it turns
# places and axes of the splats and leaves their harmonics: a splat redder from the front is still so from the front, not from the side. All its files say that the scene was trained
# with antialiasing, so that viewers that heed the flag dim small splats. And what lies beyond 2,048 units is gathered in a wall there, without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit @sparkjsdev/spark@2.2.0 three@0.180.0 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { readFileSync } from 'node:fs'
import { gunzipSync } from 'node:zlib'
import { transcodeSpz } from '@sparkjsdev/spark'

const places = [[1, 2, 3], [3000, 2, 3]]
const rest = Array.from({ length: 45 }, (_, number) => [0.5, 0.25, -0.5][number] ?? 0) // red alone, by y, z and x
const names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2', ...rest.map((_, number) => `f_rest_${number}`)]
names.push('opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3')
const rows = new Float32Array(places.flatMap((place) => [...place, 0, 0, 0, ...rest, 2, -3, -4, -5, 1, 0, 0, 0]))
const head = ['ply', 'format binary_little_endian 1.0', `element vertex ${places.length}`, ...names.map((name) => `property float ${name}`), 'end_header', ''].join('\n')
const fileBytes = new Uint8Array(Buffer.concat([Buffer.from(head), Buffer.from(rows.buffer)]))

async function transcode(transform) {
  const bytes = gunzipSync((await transcodeSpz({ inputs: [{ fileBytes, transform }], maxSh: 3 })).fileBytes)
  const view = new DataView(bytes.buffer, bytes.byteOffset)
  const [count, fraction, flags] = [view.getUint32(8, true), bytes[13], bytes[14]]
  const at = (byte) => (((bytes[byte] | (bytes[byte + 1] << 8) | (bytes[byte + 2] << 16)) << 8) >> 8) / (1 << fraction)
  const harmonics = 16 + count * (9 + 1 + 3 + 3 + 3)
  const red = [0, 3, 6].map((colour) => (bytes[harmonics + colour] - 128) / 128)
  return { version: view.getUint32(4, true), flags, places: Array.from({ length: 3 * count }, (_, k) => +at(16 + 3 * k).toFixed(2)), red }
}
await new Promise((resolve) => setTimeout(resolve, 3000)) // its WebAssembly is compiled meanwhile
const asIs = await transcode()
const turned = await transcode({ quaternion: [0, 0, Math.SQRT1_2, Math.SQRT1_2] }) // x to y, y to -x
const spark = JSON.parse(readFileSync('node_modules/@sparkjsdev/spark/package.json')).version
console.log(`Spark ${spark}: SPZ version ${asIs.version}, flags ${asIs.flags}, places ${asIs.places}, red by y, z, x ${asIs.red}`)
console.log(`a quarter of a turn: places ${turned.places}, red by y, z, x ${turned.red}, true: -0.5,0.25,-0.5`)
assert.deepStrictEqual([asIs.version, asIs.red], [2, [0.5, 0.25, -0.5]])
assert.deepStrictEqual(turned.places.slice(0, 3), [-2, 1, 3])
assert.deepStrictEqual(turned.red, asIs.red, 'the harmonics: the behaviour has changed')
assert.strictEqual(asIs.flags, 1, 'the flag: the behaviour has changed')
assert.deepStrictEqual([asIs.places[3], turned.places[4]], [2048, 2048], 'far places: the behaviour has changed')
JS
node look.mjs || exit 1
