#!/usr/bin/env bash
# A good guess: image-js, which draws and measures pictures in browsers, resizes a picture so that what is in it stays where it is, leaves it as it is at
# its own size, and takes derivatives of 16 bits in 16 bits. Found: all that it resizes, unless by nearest neighbours, lies half a new pixel
# to the lower right: at its own size a ramp of 1000, 1100, 1200 becomes 1000, 1050, 1150; at half, 1150 where 1250 is right. And
# its Sobel filter gives 8 bits, of which only the lower ones of a 16-bit picture's derivative are left: 800 is 32.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit image-js@1.7.0 > npm.log 2>&1
cat > ramp.mjs <<'JS'
import { readFileSync } from 'node:fs'
import { Image } from 'image-js'
const ramp = new Image(8, 8, { bitDepth: 16, colorModel: 'GREY' })
for (let index = 0; index < 64; index += 1) ramp.setValueByIndex(index, 0, 1000 + 100 * (index % 8))
const row = (picture) => Array.from({ length: picture.width }, (_, column) => picture.getValue(column, picture.height - 1, 0))
const resized = (width, interpolationType) => row(ramp.resize({ width, height: width, interpolationType }))
const slope = ramp.derivativeFilter({ filter: 'sobel' })
const found = [resized(8, 'bilinear'), resized(4, 'bilinear'), resized(16, 'bilinear'), resized(8, 'nearest'), row(slope)]
console.log('image-js', JSON.parse(readFileSync('node_modules/image-js/package.json')).version,
  `a ramp of ${row(ramp)} at its own size: ${found[0]}; half: ${found[1]}; double: ${found[2]}; own size, nearest: ${found[3]}`,
  `Sobel: ${slope.bitDepth} bits, ${found[4]}`)
const expected = [
  [1000, 1050, 1150, 1250, 1350, 1450, 1550, 1650], [1000, 1150, 1350, 1550],
  [1000, 1000, 1050, 1100, 1150, 1200, 1250, 1300, 1350, 1400, 1450, 1500, 1550, 1600, 1650, 1700], row(ramp),
  [144, 32, 32, 32, 32, 32, 32, 144],
]
if (slope.bitDepth !== 8 || JSON.stringify(found) !== JSON.stringify(expected)) {
  console.error('the behaviour has changed')
  process.exit(1)
}
JS
node ramp.mjs
