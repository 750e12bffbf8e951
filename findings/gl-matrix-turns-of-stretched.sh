#!/usr/bin/env bash
# A good guess: mat4.getRotation() and mat4.decompose() of gl-matrix give the turn that mat4.fromRotationTranslationScale() was given, whatever the
# scale, since both take the scale out. Found: they divide the elements of each column by all three scales instead of by that column's: for scales of
# 2, 3, 4 the quaternion is another turn, 10 degrees away, and not of length 1; mirrored matrices lose their sign and give 0, 0, 0, 0.7071. Equal
# scales are right, and three.js is right about each of these.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-audit --no-fund gl-matrix@3.4.4 three@0.180.0
cat > turns.mjs <<'JS'
import { createRequire } from "module";
import { mat4, quat } from "gl-matrix";
import { Matrix4, Quaternion, Vector3 } from "three";
const version = createRequire(import.meta.url)("gl-matrix/package.json").version;
const given = quat.fromEuler(quat.create(), 20, 30, 40);
const text = (values) => Array.from(values, (value) => value.toFixed(4)).join(" ");
function apart(found) {
  const unit = quat.normalize(quat.create(), found);
  return (2 * Math.acos(Math.min(1, Math.abs(quat.dot(unit, given)))) * 180) / Math.PI;
}
function read(scale) {
  const matrix = mat4.fromRotationTranslationScale(mat4.create(), given, [1, 2, 3], scale);
  const turn = mat4.getRotation(quat.create(), matrix);
  const other = new Quaternion();
  new Matrix4().fromArray(matrix).decompose(new Vector3(), other, new Vector3());
  const parts = { turn: quat.create() };
  mat4.decompose(parts.turn, [], [], matrix);
  console.log("gl-matrix", version, "scale", scale.join(" "), "given", text(given), "read", text(turn), "length", quat.length(turn).toFixed(4), "degrees apart", apart(turn).toFixed(2), "; decompose", apart(parts.turn).toFixed(2), "; three.js", apart(other.toArray()).toFixed(2));
  return [quat.length(turn), apart(turn), apart(parts.turn), apart(other.toArray())];
}
const equal = read([2, 2, 2]), stretched = read([2, 3, 4]);
const mirrored = mat4.getRotation(quat.create(), mat4.fromScaling(mat4.create(), [-1, 2, 3]));
console.log("a mirror of x:", text(mirrored));
const same = equal[1] < 0.1 && stretched[3] < 0.1 && stretched[1] > 5 && stretched[2] > 5 && Math.abs(stretched[0] - 1) > 0.01;
if (!same || Math.abs(mirrored[3] - 0.7071) > 1e-3) {
  console.error("the behaviour has changed");
  process.exit(1);
}
JS
node turns.mjs
