#!/usr/bin/env bash
# A good guess: a writer of SPZ, whose positions have 24 bits, takes as many of them for the fraction as a scene's size allows (the header has
# a byte for it), or refuses what is too far. Found: splat-transform and spz-js always take 12, so that ±2,048 units is all there is, and what
# lies beyond comes round on the other side without a word: 10,000 becomes 1,808. A scene in millimetres ends at two metres.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit spz-js@1.2.5 @playcanvas/splat-transform@3.7.0 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { execFileSync } from 'node:child_process'
import { readFileSync, writeFileSync } from 'node:fs'
import { loadPly, loadSpz, serializePly, serializeSpz } from 'spz-js'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const written = [100.125, -2000, 2047, -3000, 1e4, -1e4]
const cloud = {
  numPoints: 2, shDegree: 0, antialiased: false, positions: Float32Array.from(written), scales: new Float32Array(6).fill(-3),
  rotations: Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1]), alphas: new Float32Array(2).fill(1), colors: new Float32Array(6),
  sh: new Float32Array(0),
}
const round = (values) => Array.from(values).map((value) => Math.round(1000 * value) / 1000)
const bySpzJs = round((await loadSpz(await serializeSpz(cloud))).positions)
writeFileSync('far.ply', Buffer.from(serializePly(cloud)))
assert.deepStrictEqual(round((await loadPly(new Blob([readFileSync('far.ply')]).stream())).positions), written)
const convert = (from, to) => execFileSync('node_modules/.bin/splat-transform', ['-w', from, to], { encoding: 'utf8', stdio: ['ignore', 'pipe', 'pipe'] })
const said = convert('far.ply', 'far.spz')
convert('far.spz', 'back.ply')
const bySplatTransform = round((await loadPly(new Blob([readFileSync('back.ply')]).stream())).positions)
console.log('written           ', ...written)
console.log('spz-js 1.2.5      ', ...bySpzJs)
console.log('splat-transform 3.7.0', ...bySplatTransform)
const wrapped = written.map((value) => ((((value + 2048) % 4096) + 4096) % 4096) - 2048)
assert.deepStrictEqual(bySpzJs, wrapped, 'the behaviour has changed')
assert.deepStrictEqual(bySplatTransform, wrapped, 'the behaviour has changed')
assert(!/warn|range|clamp/i.test(said), 'the behaviour has changed')
JS
node look.mjs
