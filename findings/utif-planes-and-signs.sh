#!/usr/bin/env bash
# A good guess: UTIF.toRGBA8() shows each TIFF that UTIF decodes without a word: a picture in planes (PlanarConfiguration 2) as the same picture with
# its colours side by side, and signed or 32-bit numbers from dark to bright. Found: neighbours of the first plane are taken for red, green and
# blue, and two thirds of the picture are black; signed numbers wrap, so that -1 is white and 0 is black; of 32-bit whole numbers all
# pixels are 0 with no opacity. Colours side by side are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 tifffile==2026.3.3
npm install --silent --no-audit --no-fund utif@3.1.0
v/bin/python - <<'PY'
import numpy as np
import tifffile

picture = np.zeros((2, 6, 3), np.uint8)
picture[..., 0], picture[..., 1], picture[..., 2] = 200, 100, 50
picture[:, :, 0] += np.arange(6, dtype=np.uint8)
tifffile.imwrite("side.tif", picture, photometric="rgb")
tifffile.imwrite("planes.tif", np.moveaxis(picture, 2, 0), photometric="rgb", planarconfig="separate")
assert (np.moveaxis(tifffile.imread("planes.tif"), 0, 2) == tifffile.imread("side.tif")).all()
tifffile.imwrite("signed.tif", np.array([[-32768, -1, 0, 32767]], np.int16))
tifffile.imwrite("wide.tif", np.array([[0, 1 << 31, 0xFFFFFFFF, 1000]], np.uint32))
PY
node - <<'JS'
const fs = require("fs");
const UTIF = require("utif");
function read(name) {
  const bytes = fs.readFileSync(name);
  const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  const page = UTIF.decode(buffer)[0];
  UTIF.decodeImage(buffer, page);
  const colours = Array.from(UTIF.toRGBA8(page));
  const pixels = Array.from({ length: colours.length / 4 }, (_, index) => colours.slice(4 * index, 4 * index + 4).join(" "));
  console.log("utif", require("utif/package.json").version, name, pixels.join(" | "));
  return pixels;
}
const side = read("side.tif"), planes = read("planes.tif"), signed = read("signed.tif"), wide = read("wide.tif");
const same = side[1] === "201 100 50 255" && planes[0] === "200 201 202 255" && planes.slice(4).every((pixel) => pixel === "0 0 0 255");
const levels = signed.map((pixel) => Number(pixel.split(" ")[0]));
if (!same || levels[1] !== 255 || levels[2] !== 0 || wide.some((pixel) => pixel !== "0 0 0 0")) {
  console.error("the behaviour has changed");
  process.exit(1);
}
JS
