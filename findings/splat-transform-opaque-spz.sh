#!/usr/bin/env bash
# A Gaussian that is fully opaque in an SPZ file (opacity byte 255) comes out of splat-transform's PLY with an infinite
# opacity, and one that is fully transparent (0) with minus infinity. A good guess: a large finite logit. SPZ stores the
# opacity itself, PLY its logit ln(p / (1 - p)), and the converter takes the logit of exactly 1 and 0.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
echo '{"private": true}' > package.json
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@2.7.1 >/dev/null 2>&1
node -p '"@playcanvas/splat-transform " + require("./node_modules/@playcanvas/splat-transform/package.json").version'
python3 - <<'PY'
import gzip, struct
opacities = (255, 254, 128, 1, 0)
n = len(opacities)
body = struct.pack("<IIIBBBB", 0x5053474E, 3, n, 0, 12, 0, 0)                       # SPZ version 3, no harmonics
body += b"".join((k << 12).to_bytes(3, "little") * 3 for k in range(n))             # positions
body += bytes(opacities) + bytes([128] * 3 * n) + bytes([120] * 3 * n)              # opacities, colours, sizes
body += struct.pack("<I", 3 << 30) * n                                              # rotations: none
open("scene.spz", "wb").write(gzip.compress(body))
PY
node node_modules/@playcanvas/splat-transform/bin/cli.mjs -q -w scene.spz scene.ply
python3 - <<'PY'
import struct, sys
data = open("scene.ply", "rb").read()
head, rest = data.split(b"end_header\n", 1)
names = [line.split()[-1].decode() for line in head.split(b"\n") if line.startswith(b"property float")]
rows = [struct.unpack_from(f"<{len(names)}f", rest, 4 * len(names) * k) for k in range(5)]
seen = [row[names.index("opacity")] for row in rows]
print("opacity bytes 255, 254, 128, 1, 0 ->", seen)
sys.exit(not (seen[0] == float("inf") and seen[4] == float("-inf") and all(abs(v) < 6 for v in seen[1:4])))
PY
