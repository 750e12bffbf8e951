#!/usr/bin/env bash
# A good guess: gsplat.js gives the three angles back that a turn was made of, turns by half a circle to look straight back, and knows the bounds
# of a turned scene. Found: angles go in in one order and come out in another: 0.3, 0.4, 0.5 as 0.45, 0.21, 0.49. A look along -z is a quaternion
# of length 3.3, 35 degrees from z, that makes vectors 11 times as long. Bounds leave out the turn, before and after it is applied to the
# splats; and a scale along x stretches each splat's own first axis, wherever it points.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit gsplat@1.2.9 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { readFileSync } from 'node:fs'
import { Quaternion, Splat, SplatData, Vector3 } from 'gsplat'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})
const rounded = (vector) => vector.flat().map((value) => Math.round(value * 100) / 100 + 0)

const angles = rounded(Quaternion.FromEuler(new Vector3(0.3, 0.4, 0.5)).toEuler())
const back = Quaternion.LookRotation(new Vector3(0, 0, -1))
const forward = new Vector3(0, 0, 1)
const degrees = (Math.atan2(back.normalize().apply(forward).x, back.normalize().apply(forward).z) * 180) / Math.PI
const { version } = JSON.parse(readFileSync('node_modules/gsplat/package.json'))
console.log(`gsplat.js ${version}: angles 0.3, 0.4, 0.5 become`, angles, 'z, to look along -z:', rounded(back.apply(forward)), degrees, 'degrees')
assert.deepStrictEqual(angles, [0.45, 0.21, 0.49], 'the behaviour has changed')
assert(Math.abs(degrees - 35.31) < 0.01 && back.apply(forward).magnitude() > 10, 'the behaviour has changed')
assert.deepStrictEqual(rounded(Quaternion.LookRotation(new Vector3(1, 0, 0)).apply(forward)), [1, 0, 0], 'the behaviour has changed')

// Two splats on the x axis, each turned by a quarter about z so that its first axis is the world's y.
const quarter = Quaternion.FromEuler(new Vector3(0, 0, Math.PI / 2))
const turns = [quarter.w, quarter.x, quarter.y, quarter.z]
const two = () =>
  new Splat(new SplatData(2, new Float32Array([-1, 0, 0, 1, 0, 0]), new Float32Array([...turns, ...turns]), new Float32Array([1, 2, 3, 1, 2, 3]), new Uint8Array(8)))
const size = (splat) => rounded(splat.bounds.size())
const turned = two()
turned.rotation = quarter
const before = size(turned)
turned.applyRotation()
const after = size(turned)
turned.recalculateBounds()
console.log('bounds of 2 along x, turned to y:', before, 'applied:', after, 'asked to recalculate:', size(turned))
assert.deepStrictEqual([before, after, size(turned)], [[2, 0, 0], [2, 0, 0], [0, 2, 0]], 'the behaviour has changed')

const stretched = two()
stretched.scale = new Vector3(10, 1, 1)
stretched.applyScale()
console.log('10 times along x: places', Array.from(stretched.data.positions), 'scales', Array.from(stretched.data.scales.slice(0, 3)), 'of axes y, x, z')
assert.deepStrictEqual(Array.from(stretched.data.scales.slice(0, 3)), [10, 2, 3], 'the behaviour has changed')
JS
node look.mjs
