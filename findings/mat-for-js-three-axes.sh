#!/usr/bin/env bash
# A good guess: mat-for-js, which reads .mat files of MATLAB in JavaScript, reads a stack of pictures or masks, an array of three axes,
# as it reads a matrix: value [i][j][k] is MATLAB's (i+1, j+1, k+1). Found: pages are taken to lie as many values apart as a row has
# columns, not as a page has values: of a stack of 2 x 3 x 4 values 18 are out of place and nine never read, with no word. Two axes are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1
npm install --silent --no-audit --no-fund mat-for-js@1.1.0
v/bin/python - <<'PY'
import numpy as np
import scipy.io

scipy.io.savemat("stack.mat", {"page": np.arange(6.0).reshape(2, 3), "stack": np.arange(24.0).reshape(2, 3, 4)})
PY
node - <<'JS'
const fs = require("fs");
const { read } = require("mat-for-js");
const bytes = fs.readFileSync("stack.mat");
const { page, stack } = read(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length)).data;
const right = (i, j, k) => 12 * i + 4 * j + k;
let wrong = 0;
const seen = new Set();
for (let i = 0; i < 2; i++)
  for (let j = 0; j < 3; j++)
    for (let k = 0; k < 4; k++) {
      wrong += stack[i][j][k] !== right(i, j, k);
      seen.add(stack[i][j][k]);
    }
console.log("mat-for-js", require("mat-for-js/package.json").version, "page", JSON.stringify(page));
console.log("stack[0][0]", JSON.stringify(stack[0][0]), "is [0,1,2,3]; values out of place", wrong, "of 24, different values read", seen.size);
if (JSON.stringify(page) !== "[[0,1,2],[3,4,5]]" || wrong < 15 || seen.size >= 24) {
  console.error("the behaviour has changed");
  process.exit(1);
}
JS
