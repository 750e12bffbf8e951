#!/usr/bin/env bash
# A good guess: Quaternion.Euler() of math3d, made of a quaternion's own eulerAngles, is that quaternion. Found: straight up or down the heading
# and the roll are read as 0, instead of one of them as both: a camera that looks straight down at a bench, turned by 40 degrees about the
# vertical, comes back turned by none. A thousandth of a degree beside it all is right, as elsewhere, angles beyond their range included.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-fund --no-audit math3d@0.2.2 > npm.log 2>&1
cat > look.cjs <<'JS'
const assert = require('node:assert')
const { Quaternion } = require('math3d')
process.on('uncaughtException', (error) => {
  console.error(error.message)
  process.exit(1)
})

// How many degrees a turn is from the one that its own angles make.
function off(...angles) {
  const turn = Quaternion.Euler(...angles)
  const { x, y, z } = turn.eulerAngles
  const degrees = turn.angleTo(Quaternion.Euler(x, y, z)) || 0
  console.log('math3d 0.2.2: pitch, heading, roll', angles, 'are read as', [x, y, z].map((each) => +each.toFixed(3)), 'off by', degrees.toFixed(2), 'degrees')
  return degrees
}
for (const angles of [[10, 20, 30], [60, 350, 5], [100, 40, 0], [89.999, 40, 0], [-89.999, 40, 0]]) assert(off(...angles) < 0.01)
for (const pitch of [90, -90]) {
  for (const heading of [40, 170]) assert(Math.abs(off(pitch, heading, 0) - heading) < 0.1, 'the behaviour has changed')
}
JS
node look.cjs
