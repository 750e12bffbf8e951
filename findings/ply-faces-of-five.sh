#!/usr/bin/env bash
# A good guess: a reader of PLY meshes makes triangles of polygons of any number of corners, or says which it cannot. Found: three.js and
# loaders.gl make triangles of those with three and four, and leave out those with five and more without a word: of a
# dodecahedron no face is left. They also cut a square along different diagonals.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit three@0.187.0 @loaders.gl/core@4.4.5 @loaders.gl/ply@4.4.5 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { parse } from '@loaders.gl/core'
import { PLYLoader } from '@loaders.gl/ply'
import { REVISION } from 'three'
import { PLYLoader as OfThree } from 'three/examples/jsm/loaders/PLYLoader.js'
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

const head = ['ply', 'format ascii 1.0', 'element vertex 6', ...['x', 'y', 'z'].map((name) => `property float ${name}`)]
const corners = ['0 0 0', '1 0 0', '2 1 0', '1 2 0', '0 2 0', '-1 1 0']
async function read(faces) {
  const list = [`element face ${faces.length}`, 'property list uchar int vertex_indices', 'end_header']
  const file = new TextEncoder().encode([...head, ...list, ...corners, ...faces, ''].join('\n')).buffer
  const three = new OfThree().parse(file.slice(0)).index
  const { indices } = await parse(file.slice(0), PLYLoader, { worker: false })
  return [three ? Array.from(three.array) : [], Array.from(indices.value)]
}
const square = await read(['4 0 1 3 4'])
const five = await read(['5 0 1 2 3 4', '3 0 4 5'])
const six = await read(['6 0 1 2 3 4 5', '3 0 4 5'])
console.log(`three r${REVISION} and loaders.gl 4.4.5, corners of the triangles of a square:`, ...square)
console.log('of a polygon of five and a triangle:', ...five, 'of one of six and a triangle:', ...six)
assert(square.every((triangles) => triangles.length === 6), 'the behaviour has changed')
for (const found of [...five, ...six]) assert.deepStrictEqual(found, [0, 4, 5], 'the behaviour has changed')
assert.notDeepStrictEqual(square[0], square[1], 'the behaviour has changed')
JS
node look.mjs
