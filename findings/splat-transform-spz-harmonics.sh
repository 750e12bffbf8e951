#!/usr/bin/env bash
# splat-transform writes the direction-dependent colours of an SPZ file in steps of 1/16 (first degree) and 1/8 (second and
# third), although the format gives each coefficient 8 bits, and has no option for it: `--spz-version` alone. A good guess:
# steps of 1/128. A scene whose coefficients are below 1/16 loses all of them.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
echo '{"private": true}' > package.json
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@2.7.1 >/dev/null 2>&1
node -p '"@playcanvas/splat-transform " + require("./node_modules/@playcanvas/splat-transform/package.json").version'
python3 - <<'PY'
import struct
rest = [f"f_rest_{k}" for k in range(45)]
names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", *rest, "opacity", "scale_0", "scale_1", "scale_2"]
names += ["rot_0", "rot_1", "rot_2", "rot_3"]
head = f"ply\nformat binary_little_endian 1.0\nelement vertex 100\n" + "".join(f"property float {n}\n" for n in names)
rows = b""
for k in range(100):
    value = (k - 50) / 100
    rows += struct.pack(f"<{len(names)}f", k, 0, 5, 0, 0, 0, *[value] * 45, 1, -2, -2, -2, 1, 0, 0, 0)
open("scene.ply", "wb").write(head.encode() + b"end_header\n" + rows)
PY
node node_modules/@playcanvas/splat-transform/bin/cli.mjs -q -w scene.ply --spz-version 3 scene.spz
python3 - <<'PY'
import gzip, sys
body = gzip.decompress(open("scene.spz", "rb").read())
found = body[16 + 100 * (9 + 1 + 3 + 3 + 4):]
first = {found[45 * k + j] for k in range(100) for j in range(9)}
later = {found[45 * k + j] for k in range(100) for j in range(9, 45)}
print("a hundred coefficients from -0.5 to 0.49; bytes of the first degree:", sorted(first))
print("of the second and third:", sorted(later))
step = lambda values: min(b - a for a, b in zip(sorted(values), sorted(values)[1:]))
print("smallest steps, in 1/128:", step(first), step(later))
sys.exit(not (step(first) == 8 and step(later) == 16))
PY
