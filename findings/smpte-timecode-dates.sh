#!/usr/bin/env bash
# A good guess: the npm package smpte-timecode makes the timecode of a time of day at 24000/1001 frames a second, and its toDate() gives the time back.
# Found: times are counted by the rate rounded to two digits, 23.98, and read by 24000/1001: at 20:00 the timecode is 11.94 s late, 286 frames, and
# toDate() gives 20:00:11.94. At 30000/1001 it is 72 ms early by then. Whole rates are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
npm install --silent --no-audit --no-fund smpte-timecode@1.3.6
TZ=UTC node - <<'JS'
const Timecode = require("smpte-timecode");
const wrong = {};
for (const rate of [[24, 1], [24000, 1001], [30000, 1001]]) {
  const evening = new Date();
  evening.setHours(20, 0, 0, 0);
  const code = Timecode(evening, rate, false);
  wrong[rate] = (code.toDate() - evening) / 1000;
  const frames = Math.round((72000 * rate[0]) / rate[1]);
  console.log("smpte-timecode", require("smpte-timecode/package.json").version, rate.join("/"), "20:00 is", code.toString(), "frame", code.frameCount, "of", frames, "; back:", wrong[rate], "s off");
}
if (wrong["24,1"] !== 0 || Math.abs(wrong["24000,1001"] - 11.94) > 0.05 || Math.abs(wrong["30000,1001"] + 0.072) > 0.01) {
  console.error("the behaviour has changed");
  process.exit(1);
}
JS
