#!/usr/bin/env bash
# A good guess: sharp, which takes raw Uint16Array and Float32Array and gives raw({ depth: 'ushort' }) and raw({ depth: 'float' }), carries a map
# of depth from one to the other. Found: the numbers that come out are those of 8 bits, cut and not rounded, in three channels, stored in 16 or 32: 65279
# becomes 254. Sixteen bits need toColourspace('grey16'). Fractions of a Float32Array survive no colour space at all: 1.5 m is 1 or 0, although
# a TIFF of floats comes through 'b-w' whole. Metadata and types say ushort and float throughout.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit sharp@0.35.5 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import sharp from 'sharp'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const as = (Kind, { data }) => Array.from(new Kind(data.buffer.slice(data.byteOffset, data.byteOffset + data.length)))
async function through(array, depth, space) {
  let way = sharp(array, { raw: { width: array.length, height: 1, channels: 1 } })
  if (space) way = way.toColourspace(space)
  const out = await way.raw({ depth }).toBuffer({ resolveWithObject: true })
  assert.strictEqual(out.info.depth, depth)
  const values = as(array.constructor, out)
  return { channels: out.info.channels, first: values.filter((_, i) => i % out.info.channels === 0), whole: values.every(Number.isInteger) }
}

const readings = Uint16Array.from([7, 255, 256, 1007, 30000, 65279, 65535])
const plain = await through(readings, 'ushort'), grey16 = await through(readings, 'ushort', 'grey16')
console.log('sharp', sharp.versions.sharp, 'of', ...readings)
console.log('ushort        ', ...plain.first, 'in', plain.channels, 'channels')
console.log('ushort, grey16', ...grey16.first, 'in', grey16.channels)
assert.deepStrictEqual(grey16.first, [...readings])
assert.deepStrictEqual(plain.first, [...readings].map((value) => value >> 8), 'the behaviour has changed')
assert.strictEqual(plain.channels, 3, 'the behaviour has changed')
const inPng = await sharp(readings, { raw: { width: 7, height: 1, channels: 1 } }).png().toBuffer()
assert.strictEqual((await sharp(inPng).metadata()).depth, 'uchar', 'the behaviour has changed')

const metres = Float32Array.from([0.1, 0.5, 1, 1.5, 100, 200.75])
console.log('of', ...metres)
for (const space of ['srgb', 'b-w', 'grey16', 'rgb16']) {
  const out = await through(metres, 'float', space)
  console.log('float,', space.padEnd(7), ...out.first)
  assert(out.whole, 'the behaviour has changed')
}
assert.deepStrictEqual((await through(metres, 'float', 'grey16')).first, [0, 0, 1, 1, 100, 200], 'the behaviour has changed')
assert.deepStrictEqual((await through(metres, 'float')).first, [0, 0, 0, 0, 0, 0], 'the behaviour has changed')

// The same as an uncompressed TIFF of one strip: type 3 is short, 4 is long; sample format 3 is float.
const tags = [[256, 3, 6], [257, 3, 1], [258, 3, 32], [259, 3, 1], [262, 3, 1], [273, 4, 134], [277, 3, 1], [278, 3, 1], [279, 4, 24], [339, 3, 3]]
const file = Buffer.alloc(158)
file.write('II'); file.writeUInt16LE(42, 2); file.writeUInt32LE(8, 4); file.writeUInt16LE(tags.length, 8)
tags.forEach(([tag, type, value], i) => {
  file.writeUInt16LE(tag, 10 + 12 * i); file.writeUInt16LE(type, 12 + 12 * i); file.writeUInt32LE(1, 14 + 12 * i); file.writeUInt32LE(value, 18 + 12 * i)
})
Buffer.from(metres.buffer).copy(file, 134)
const read = await sharp(file).toColourspace('b-w').raw({ depth: 'float' }).toBuffer({ resolveWithObject: true })
assert.deepStrictEqual(as(Float32Array, read), [...metres])
JS
node look.mjs
