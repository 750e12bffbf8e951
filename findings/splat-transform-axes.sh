#!/usr/bin/env bash
# One PLY file, written by splat-transform as SOG and as GLB: the SOG holds the PLY's numbers (y down, although the format's
# page says "y: up"), the GLB those after half a turn about z. A good guess: both are turned, since both specify y up, or
# neither. Whoever writes SOG by its page alone is shown upside down.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
echo '{"private": true}' > package.json
npm install --silent --no-audit --no-fund @playcanvas/splat-transform@2.7.1 >/dev/null 2>&1
node -p '"@playcanvas/splat-transform " + require("./node_modules/@playcanvas/splat-transform/package.json").version'
python3 - <<'PY'
import struct
names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
names += ["rot_0", "rot_1", "rot_2", "rot_3"]
head = "ply\nformat binary_little_endian 1.0\nelement vertex 300\n" + "".join(f"property float {n}\n" for n in names)
rows = b""
for k in range(300):  # all of them right of, below and before the camera: x in 1 ... 2, y in 2 ... 3, z in 5 ... 6
    part = k / 299
    rows += struct.pack(f"<{len(names)}f", 1 + part, 2 + part, 5 + part, 0, 0, 0, 1, -3, -3, -3, 1, 0, 0, 0)
open("scene.ply", "wb").write(head.encode() + b"end_header\n" + rows)
PY
for kind in sog glb; do node node_modules/@playcanvas/splat-transform/bin/cli.mjs -q -w -g cpu scene.ply scene.$kind; done
python3 - <<'PY'
import json, math, struct, sys, zipfile
means = json.loads(zipfile.ZipFile("scene.sog").read("meta.json"))["means"]
unlog = lambda v: math.copysign(math.expm1(abs(v)), v)
sog = [(round(unlog(a), 3), round(unlog(b), 3)) for a, b in zip(means["mins"], means["maxs"])]
data = open("scene.glb", "rb").read()
told = json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])
place = told["accessors"][told["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
glb = [(round(a, 3), round(b, 3)) for a, b in zip(place["min"], place["max"])]
print("PLY: x 1 ... 2, y 2 ... 3, z 5 ... 6")
print("SOG:", sog)
print("GLB:", glb)
sys.exit(not (sog == [(1, 2), (2, 3), (5, 6)] and glb == [(-2, -1), (-3, -2), (5, 6)]))
PY
