#!/usr/bin/env bash
# A good guess: three.js's plugin for KHR_gaussian_splatting, which demands the colour space that the extension requires, shows splats of
# light (lin_rec709_display) and of screen values (srgb_rec709_display) as what they are, or warns, as it does of projection and sorting.
# Found: any name passes, unread: both give the same geometry, colours and material, so that with one setting of the renderer's output one of the two
# comes out too light or too dark. What the file says lies in userData, for those who look.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit three@0.187.0 > npm.log 2>&1
cat > look.mjs <<'JS'
import assert from 'node:assert'
import { REVISION } from 'three'
import { GLTFGaussianSplatLoaderExtension } from 'three/addons/loaders/GLTFGaussianSplatLoaderExtension.js'
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js'
globalThis.self = globalThis
globalThis.ProgressEvent ??= class extends Event {}
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})
const warned = []
console.warn = (...words) => warned.push(words.join(' '))

const name = 'KHR_gaussian_splatting'
const kinds = { POSITION: [1, 2, 3], ROTATION: [0, 0, 0, 1], SCALE: [0.1, 0.1, 0.1], OPACITY: [0.9], SH_DEGREE_0_COEF_0: [0, 0.5, -0.5] }
function scene(told) {
  const values = [], accessors = [], bufferViews = [], attributes = {}
  for (const [kind, own] of Object.entries(kinds)) {
    attributes[kind === 'POSITION' ? kind : `${name}:${kind}`] = accessors.length
    const bounds = kind === 'POSITION' ? { min: own, max: own } : {}
    const type = own.length === 1 ? 'SCALAR' : `VEC${own.length}`
    accessors.push({ bufferView: bufferViews.length, componentType: 5126, count: 1, type, ...bounds })
    bufferViews.push({ buffer: 0, byteOffset: 4 * values.length, byteLength: 4 * own.length })
    values.push(...own)
  }
  const uri = 'data:application/octet-stream;base64,' + Buffer.from(new Float32Array(values).buffer).toString('base64')
  const primitives = [{ mode: 0, attributes, extensions: { [name]: { kernel: 'ellipse', ...told } } }]
  return JSON.stringify({
    asset: { version: '2.0' }, extensionsUsed: [name], scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }], meshes: [{ primitives }],
    accessors, bufferViews, buffers: [{ byteLength: 4 * values.length, uri }],
  })
}
const loader = new GLTFLoader().register((parser) => new GLTFGaussianSplatLoaderExtension(parser))
async function load(told) {
  const { scene: loaded } = await loader.parseAsync(scene(told), '')
  let splats
  loaded.traverse((one) => { splats = one.splatGeometry ? one : splats })
  const { type, toneMapped, userData } = splats.material
  return { colours: [...splats.splatGeometry.getAttribute('color').array], material: JSON.stringify({ type, toneMapped, userData }), said: splats.userData.gltfExtensions[name].colorSpace }
}
const of = {}
for (const space of ['srgb_rec709_display', 'lin_rec709_display', 'no_such_space']) {
  of[space] = await load({ colorSpace: space })
  console.log('three', REVISION, space.padEnd(20), 'colours', ...of[space].colours, 'userData', of[space].said)
}
const quiet = warned.length
await load({ colorSpace: 'srgb_rec709_display', sortingMethod: 'other' })
console.log('warnings of colour spaces', quiet, 'of an unknown sorting', warned.length - quiet)
await assert.rejects(load({}), /colorSpace is required/)
const [srgb, light, none] = Object.values(of)
for (const other of [light, none]) {
  assert.deepStrictEqual(other.colours, srgb.colours, 'the behaviour has changed')
  assert.strictEqual(other.material, srgb.material, 'the behaviour has changed')
}
assert(quiet === 0 && warned.length === 1, 'the behaviour has changed')
JS
node --no-deprecation look.mjs
