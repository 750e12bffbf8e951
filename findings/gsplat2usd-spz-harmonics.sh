#!/usr/bin/env bash
# A good guess: NVIDIA's gsplat2USD keeps the colours of an SPZ file's splats by whichever of its functions, and `source_file` of its writer, "for layer metadata", can
# be left out. Found: that name's ending tells how harmonics are ordered. Without it, and always in PLY files by write_ply(), those of SPZ are taken for PLY's: what depends
# on the direction in red alone then does so in all three colours, along one axis. And turning a scene (`--rotate-x`) turns places and axes of splats, but not their harmonics.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gsplat2USD==0.1.5 usd-core==26.11 numpy==2.3.1
cat > look.py <<'PY'
import contextlib
import gzip
import io
import struct
from importlib.metadata import version
from pathlib import Path

import numpy as np
from gsplat2USD import read_spz, write_gaussian_splat_usd
from gsplat2USD.ply_reader import read_ply
from gsplat2USD.ply_writer import write_ply
from pxr import Usd

# One splat of degree 1 at (1, 2, 3). SPZ has red, green and blue of each coefficient side by side.
true = np.array([[0.5, 0, 0], [0.25, 0, 0], [-0.5, 0, 0]])  # coefficient (y, z, x), colour: only red depends on the direction
body = struct.pack("<IIIBBBB", 0x5053474E, 3, 1, 1, 12, 0, 0)
body += b"".join((place << 12).to_bytes(3, "little") for place in (1, 2, 3))
body += bytes([200]) + bytes([128] * 3) + bytes([120] * 3) + struct.pack("<I", 3 << 30)
body += bytes((128 + 128 * true.ravel()).astype(int).tolist())
Path("scene.spz").write_bytes(gzip.compress(body))


def stored(name):
    stage = Usd.Stage.Open(name)
    prim = stage.GetDefaultPrim()
    attribute = prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get()
    return np.array(attribute)[1:].round(3), np.array(prim.GetAttribute("positions").Get())[0].round(3)


with contextlib.redirect_stdout(io.StringIO()):
    splats = read_spz("scene.spz")
    write_gaussian_splat_usd(splats, "named.usda", source_file="scene.spz")
    write_gaussian_splat_usd(splats, "unnamed.usda")
    write_gaussian_splat_usd(splats, "turned.usda", source_file="scene.spz", rotation_degrees=(180.0, 0.0, 0.0))
    write_ply(splats, "scene.ply")
    write_gaussian_splat_usd(read_ply("scene.ply"), "by-ply.usda", source_file="scene.ply")
named, unnamed, turned, by_ply = (stored(f"{name}.usda") for name in ("named", "unnamed", "turned", "by-ply"))
print("gsplat2USD", version("gsplat2USD"), "coefficients (y, z, x) by colours (r, g, b):", named[0].tolist())
print("without source_file", unnamed[0].tolist(), "through write_ply", by_ply[0].tolist())
print("half a turn about x brings", named[1], "to", turned[1], "and the harmonics are", turned[0].tolist())
assert np.allclose(named[0], true)
mixed = true.ravel().reshape(3, 3).T
assert np.allclose(unnamed[0], mixed) and np.allclose(by_ply[0], mixed), "the order has changed"
assert np.allclose(turned[1], [1, -2, -3]) and np.allclose(turned[0], true), "the turn has changed"  # y and z should have turned their signs
PY
v/bin/python look.py
