#!/usr/bin/env bash
# A good guess: three.js's loaders of colour tables hold what is above white at white and below black at black where they make bytes of them, as
# they do unless told otherwise, and read a .3dl file of 12 bits by 4095. Found: .cube values wrap: 1.1 becomes 24 of 255 and -0.02 becomes
# 251, so that highlights are black and shadows white; fractions are cut, 0.999 is 254; "1E-05" is no number, and the rest of the table moves up by
# an entry; and .3dl values are divided by the power of two above the largest one: a table that darkens to a fifth is four times as bright.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-audit --no-fund three@0.187.0
cat > tables.mjs <<'JS'
import { REVISION } from "three";
import { LUT3dlLoader } from "three/examples/jsm/loaders/LUT3dlLoader.js";
import { LUTCubeLoader } from "three/examples/jsm/loaders/LUTCubeLoader.js";
const size = 5, steps = [0, 1, 2, 3, 4];
function cube(number) {
  const rows = [];
  for (const blue of steps) for (const green of steps) for (const red of steps) rows.push([red, green, blue].map((step) => number(step / 4)).join(" "));
  return `LUT_3D_SIZE ${size}\n${rows.join("\n")}\n`;
}
function lustre(factor) {
  const rows = [];
  for (const red of steps) for (const green of steps) for (const blue of steps) rows.push([red, green, blue].map((step) => Math.round((step / 4) * factor * 4095)).join(" "));
  return `0 256 512 768 1024\n${rows.join("\n")}\n`;
}
const reds = (table) => steps.map((step) => table.texture3D.image.data[4 * step]);
const found = {
  identity: reds(new LUTCubeLoader().parse(cube((value) => value))),
  "1.1 times": reds(new LUTCubeLoader().parse(cube((value) => 1.1 * value))),
  "less 0.02": reds(new LUTCubeLoader().parse(cube((value) => value - 0.02))),
  "0 as 1E-05": reds(new LUTCubeLoader().parse(cube((value) => (value ? value : "1E-05")))),
  "3dl identity": reds(new LUT3dlLoader().parse(lustre(1))),
  "3dl a fifth": reds(new LUT3dlLoader().parse(lustre(0.2))),
};
for (const [name, row] of Object.entries(found)) console.log("three.js", REVISION, name, row.join(" "));
const is = (name, row) => found[name].join() === row.join();
if (!is("identity", [0, 63, 127, 191, 255]) || !is("1.1 times", [0, 70, 140, 210, 24]) || !is("less 0.02", [251, 58, 122, 186, 249])) {
  console.error("values: the behaviour has changed");
  process.exit(1);
}
if (is("0 as 1E-05", [0, 63, 127, 191, 255]) || found["3dl identity"][4] !== 254 || found["3dl a fifth"][4] < 200) {
  console.error("numbers or bits: the behaviour has changed");
  process.exit(1);
}
JS
node tables.mjs
