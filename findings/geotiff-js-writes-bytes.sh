#!/usr/bin/env bash
# A good guess: geotiff.js writes the numbers that it is given, as it does those of unsigned and floating arrays, or refuses them. Found: of signed
# arrays of 16 and 32 bits it writes the lowest byte of each number, one beside the next in the place of the first ones, and zeros behind: -5,
# 1, 1000 and -1 in 16 bits come back as -1279, -5889, 0 and 0. Plain and nested lists become bytes, from 256 on the remainder: 1000
# is 232. Without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit geotiff@3.0.5 > npm.log 2>&1
cat > write.mjs <<'JS'
import { readFileSync } from 'node:fs'
import { fromArrayBuffer, writeArrayBuffer } from 'geotiff'
const back = async (values) => {
  const image = await (await fromArrayBuffer(await writeArrayBuffer(values, { height: 2, width: 2 }))).getImage()
  return [image.getBitsPerSample(), ...(await image.readRasters())[0]]
}
const numbers = [-5, 1, 1000, -1]
const found = {
  float32: await back(new Float32Array(numbers)),
  uint16: await back(new Uint16Array([5, 1, 1000, 65535])),
  int16: await back(new Int16Array(numbers)),
  int32: await back(new Int32Array(numbers)),
  list: await back([5, 1, 1000, 65535]),
  nested: await back([[[5, 1], [1000, 65535]]]),
}
console.log('geotiff', JSON.parse(readFileSync('node_modules/geotiff/package.json')).version, 'bits and values, read back:', JSON.stringify(found))
const expected = {
  float32: [32, ...numbers], uint16: [16, 5, 1, 1000, 65535], int16: [16, -1279, -5889, 0, 0], int32: [32, -83760897, 0, 0, 0],
  list: [8, 5, 1, 232, 255], nested: [8, 5, 1, 232, 255],
}
if (JSON.stringify(found) !== JSON.stringify(expected)) {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node write.mjs
