#!/usr/bin/env bash
# Khronos's own glTF validator from npm calls every attribute that Khronos's ratified extension KHR_gaussian_splatting asks
# for an error: "Invalid attribute name", although it only warns of an extension that it does not know. A good guess: what an
# unknown extension names is let through, as `extensionsUsed` is. So "0 errors" cannot be asked of a right file of splats.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
echo '{"private": true}' > package.json
npm install --silent --no-audit --no-fund gltf-validator@2.0.0-dev.3.10 >/dev/null 2>&1
cat > ask.js <<'JS'
const validator = require("gltf-validator");
console.log("gltf-validator", validator.version());
const extension = "KHR_gaussian_splatting";
const kinds = { POSITION: "VEC3", ROTATION: "VEC4", SCALE: "VEC3", OPACITY: "SCALAR", SH_DEGREE_0_COEF_0: "VEC3" };
const widths = { SCALAR: 1, VEC3: 3, VEC4: 4 };
const values = [], accessors = [], bufferViews = [], attributes = {};
for (const [name, type] of Object.entries(kinds)) {
  const own = type === "VEC4" ? [0, 0, 0, 1] : new Array(widths[type]).fill(0.5);
  attributes[name === "POSITION" ? name : `${extension}:${name}`] = accessors.length;
  const bounds = name === "POSITION" ? { min: own, max: own } : {};
  accessors.push({ bufferView: bufferViews.length, componentType: 5126, count: 1, type, ...bounds });
  bufferViews.push({ buffer: 0, byteOffset: 4 * values.length, byteLength: 4 * own.length, target: 34962 });
  values.push(...own);
}
const uri = "data:application/octet-stream;base64," + Buffer.from(new Float32Array(values).buffer).toString("base64");
const file = {
  asset: { version: "2.0" }, extensionsUsed: [extension], scene: 0, scenes: [{ nodes: [0] }], nodes: [{ mesh: 0 }],
  meshes: [{ primitives: [{ mode: 0, attributes, extensions: { [extension]: { kernel: "ellipse", colorSpace: "srgb_rec709_display" } } }] }],
  accessors, bufferViews, buffers: [{ byteLength: 4 * values.length, uri }],
};
validator.validateString(JSON.stringify(file)).then(({ issues }) => {
  for (const one of issues.messages) console.log(one.severity === 0 ? "error  " : "no error", one.code, one.pointer);
  const wrong = issues.messages.filter((one) => one.severity === 0);
  process.exit(wrong.length === 4 && wrong.every((one) => one.code === "MESH_PRIMITIVE_INVALID_ATTRIBUTE") ? 0 : 1);
});
JS
node ask.js
