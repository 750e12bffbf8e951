#!/usr/bin/env bash
# A good guess: Arrow in JavaScript stores what half precision cannot hold as infinity, as IEEE 754 and NumPy do, and makes null of a value that a
# row does not have. Found: numbers from 65536 on come round as small ones: 70000 becomes 2.13, 1000000 3.81, only 65520 to 65535 are infinite; 2049
# becomes 2050 where the nearest even is 2048. A column that some rows of tableFromJSON() lack holds NaN there and counts no null.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-audit --no-fund apache-arrow@21.2.0
node - <<'JS'
const { vectorFromArray, tableFromJSON, Float16 } = require("apache-arrow");
const written = [65504, 65520, 66000, 70000, 1000000, -70000, 2049];
const read = [...vectorFromArray(written, new Float16())];
console.log("apache-arrow 21.2.0, half precision:", written.map((value, index) => `${value} is ${read[index]}`).join(", "));
const lacking = tableFromJSON([{ a: 1 }, { a: 2, b: 2 }]).getChild("b");
const given = tableFromJSON([{ a: 1, b: null }, { a: 2, b: 2 }]).getChild("b");
console.log("a row without b:", lacking.get(0), "nulls", lacking.nullCount, "; with null:", given.get(0), "nulls", given.nullCount);
const same = read[0] === 65504 && read[1] === Infinity && read[3] === 2.134765625 && read[4] === 3.814453125 && read[5] === -2.134765625 && read[6] === 2050;
if (!same || !Number.isNaN(lacking.get(0)) || lacking.nullCount !== 0 || given.nullCount !== 1) {
  console.error("the behaviour has changed");
  process.exit(1);
}
JS
