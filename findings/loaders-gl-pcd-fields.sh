#!/usr/bin/env bash
# A good guess: loaders.gl, a descendant of three.js's reader, reads PCD files as PCL and three.js do. Found: red and blue of `rgb` are exchanged; `rgb`
# of whole numbers as text gives other colours; a label or intensity of four bytes comes as a colour, by its lowest byte; those of one or two bytes
# make a binary file unreadable; of double coordinates the lower four bytes are read as floats, so that 1.5 is 0; and text is taken from other
# columns after a field of several values (COUNT). three.js reads each right; the colours of PCL's `rgba` both leave out without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit @loaders.gl/core@4.4.5 @loaders.gl/pcd@4.4.2 three@0.187.0 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { parse } from '@loaders.gl/core'
import { PCDLoader } from '@loaders.gl/pcd'
import { PCDLoader as ThreeLoader } from 'three/addons/loaders/PCDLoader.js'
globalThis.self = globalThis
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const kinds = { F4: Float32Array, F8: Float64Array, U1: Uint8Array, U4: Uint32Array }
// Fields as [name, kind, values of the one point].
function file(fields, text) {
  const bytes = fields.flatMap(([, kind, values]) => [...new Uint8Array(kinds[kind].from(values).buffer)])
  const words = fields.flatMap(([, , values]) => values).join(' ') + '\n'
  const of = (pick) => fields.map(pick).join(' ')
  const head = `# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS ${of((f) => f[0])}\nSIZE ${of((f) => f[1][1])}\nTYPE ${of((f) => f[1][0])}\n` +
    `COUNT ${of((f) => f[2].length)}\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA ${text ? 'ascii' : 'binary'}\n`
  return new Uint8Array([...Buffer.from(head), ...(text ? Buffer.from(words) : bytes)]).buffer
}
async function look(label, fields, text = false) {
  const data = file(fields, text)
  const three = new ThreeLoader().parse(data.slice(0)).geometry.attributes
  const byThree = Object.fromEntries(Object.entries(three).map(([name, { array }]) => [name, [...array]]))
  let own
  try {
    const { attributes } = await parse(data.slice(0), PCDLoader, { worker: false })
    own = Object.fromEntries(Object.entries(attributes).map(([name, { value }]) => [name, [...value]]))
  } catch (error) {
    own = { error: error.message }
  }
  console.log(label.padEnd(34), JSON.stringify(own), 'three.js', JSON.stringify(byThree))
  return [own, byThree]
}
const place = (kind = 'F4', at = [1.5, -2.5, 4]) => ['x', 'y', 'z'].map((name, i) => [name, kind, [at[i]]])
const packed = (200 << 16) | (100 << 8) | 50
const asFloat = new Float32Array(Uint32Array.of(packed).buffer)[0]
const floats = (await look('rgb 200 100 50 as float', [...place(), ['rgb', 'F4', [asFloat]]]))
const words = (await look('rgb 200 100 50 as number, text', [...place(), ['rgb', 'U4', [packed]]], true))
const label = (await look('label 70000', [...place(), ['label', 'U4', [70000]]]))
const bright = (await look('intensity 60 of one byte', [...place(), ['intensity', 'U1', [60]]]))
const doubles = (await look('1.5 -2.5 4 in double precision', place('F8')))
const counted = (await look('feature 10 20 30 before x, text', [['feature', 'F4', [10, 20, 30]], ...place()], true))
const rgba = (await look('rgba', [...place(), ['rgba', 'U4', [packed]]]))

const at = [1.5, -2.5, 4]
for (const [, byThree] of [floats, words, label, bright, doubles, counted]) assert.deepStrictEqual(byThree.position, at)
assert(floats[1].color[0] > floats[1].color[1] && floats[1].color[1] > floats[1].color[2])
assert.deepStrictEqual([label[1].label, bright[1].intensity], [[70000], [60]])
assert.deepStrictEqual(floats[0].COLOR_0, [50, 100, 200], 'the behaviour has changed')
assert(String(words[0].COLOR_0) !== '200,100,50' && String(words[0].COLOR_0) !== '50,100,200', 'the behaviour has changed')
assert.deepStrictEqual(label[0].COLOR_0, [70000 & 255], 'the behaviour has changed')
assert(bright[0].error, 'the behaviour has changed')
assert.deepStrictEqual(doubles[0].POSITION, [0, 0, 0], 'the behaviour has changed')
assert.notDeepStrictEqual(counted[0].POSITION, at, 'the behaviour has changed')
assert(!('COLOR_0' in rgba[0]) && !('color' in rgba[1]), 'the behaviour has changed')
JS
node --no-deprecation look.mjs
