#!/usr/bin/env bash
# A good guess: a viewer of splats adds the harmonics to the base colour and cuts the sum to 0..1, as the training does: base colours beyond
# that are common, and SPZ's bytes reach from -0.4 to 1.4 on purpose. Found: three.js's loaders (PLY, SPZ) and GaussianSplats3D cut the base colour to
# a byte first, so that a splat of 1.3 that harmonics make 0.8 from the front is shown 0.5; three.js also cuts each coefficient at -1 and 0.992.
# (The sum below is that of their shaders; the bytes are what the shaders are given.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
echo '{"private": true}' > package.json
npm install --silent --no-fund --no-audit three@0.187.0 @mkkellogg/gaussian-splats-3d@0.4.7 spz-js@1.2.5 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { PlyLoader } from '@mkkellogg/gaussian-splats-3d'
import { loadPly, serializeSpz } from 'spz-js'
import { REVISION } from 'three'
import { GaussianSplatPLYLoader } from 'three/addons/loaders/GaussianSplatPLYLoader.js'
import { SPZLoader } from 'three/addons/loaders/SPZLoader.js'
globalThis.window = globalThis
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const C0 = 0.28209479177387814, C1 = 0.4886025119029199
const bases = [1.3, -0.3, 0.5, 0.1] // Of grey splats.
const along = [-0.5, 0.5, 0.3, 1.5 * C1] // What the harmonic along z adds, seen from the front.
const names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2']
for (let i = 0; i < 9; i++) names.push(`f_rest_${i}`)
names.push('opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3')
const rows = bases.map((base, i) => {
  const dc = (base - 0.5) / C0, rest = [0, along[i] / C1, 0]
  return [i, 0, 0, dc, dc, dc, ...rest, ...rest, ...rest, 3, -2, -2, -2, 1, 0, 0, 0]
})
const head = `ply\nformat binary_little_endian 1.0\nelement vertex ${rows.length}\n${names.map((name) => `property float ${name}\n`).join('')}end_header\n`
const ply = new Uint8Array([...Buffer.from(head), ...Buffer.from(Float32Array.from(rows.flat()).buffer)]).buffer
const spz = new Uint8Array(await serializeSpz(await loadPly(new Blob([ply]).stream()))).buffer

const cut = (value) => Math.round(100 * Math.min(Math.max(value, 0), 1)) / 100
const byThree = (scene) => bases.map((_, i) => {
  const bytes = new Uint8Array(scene.getAttribute('sphericalHarmonics1').array.buffer)
  return cut(scene.getAttribute('color').array[4 * i] / 255 + C1 * (bytes[12 * i + 3] - 128) / 128)
})
const kept = await PlyLoader.loadFromFileData(ply, 0, 0, false, 1)
const colours = new Uint8Array(4 * bases.length), harmonics = new Float32Array(9 * bases.length)
kept.fillSplatColorArray(colours, 0, undefined, undefined, 0)
kept.fillSphericalHarmonicsArray(harmonics, 1, null, undefined, undefined, 0)
const shown = {
  'three.js, PLY': byThree(new GaussianSplatPLYLoader().parse(ply)),
  'three.js, SPZ': byThree(new SPZLoader().parse(spz)),
  'GaussianSplats3D, PLY': bases.map((_, i) => cut(colours[4 * i] / 255 + C1 * harmonics[9 * i + 3])),
}
const right = bases.map((base, i) => cut(base + along[i]))
console.log('three', REVISION, 'GaussianSplats3D 0.4.7: from the front')
console.log('as trained'.padEnd(22), ...right)
for (const [viewer, values] of Object.entries(shown)) console.log(viewer.padEnd(22), ...values)
const near = (values, wanted) => values.every((value, i) => Math.abs(value - wanted[i]) < 0.03)
assert(near(right, [0.8, 0.2, 0.8, 0.83]))
assert(near(shown['three.js, PLY'], [0.5, 0.5, 0.8, 0.58]), 'the behaviour has changed')
assert(near(shown['three.js, SPZ'], [0.5, 0.5, 0.8, 0.58]), 'the behaviour has changed')
assert(near(shown['GaussianSplats3D, PLY'], [0.5, 0.5, 0.8, 0.83]), 'the behaviour has changed')
JS
node --no-deprecation look.mjs
