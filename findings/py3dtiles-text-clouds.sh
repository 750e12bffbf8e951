#!/usr/bin/env bash
# A good guess: py3dtiles keeps surveyed places to a float's fraction of a tile, since it takes off an offset first and stores it as the tile's transform, and intensities as the
# float32 that it announces. Found: of PLY files so, but of text (.xyz, .csv) it reads whole coordinates in single precision and takes off the offset after that: in a national
# grid points come to lie on rows half a metre apart. Intensities of text are cut to a byte: 300 is 44, and 0.9 is 0. And colours of 0.5 in PLY files are black.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check py3dtiles==12.1.1 plyfile==1.1.5 numpy==2.3.5
cat > look.py <<'PY'
import json
import shutil
from importlib.metadata import version
from pathlib import Path

import numpy as np
import plyfile
from py3dtiles.convert import convert
from py3dtiles.tileset.content import read_binary_tile_content

number = np.arange(100)
places = np.array([652381.0, 6862047.0, 35.0]) + np.c_[number, number * 0.01, number * 0.001]  # metres of a national grid


def leaves(tile, matrix):
    matrix = matrix @ np.array(tile.get("transform", np.eye(4).ravel())).reshape(4, 4).T
    if "content" in tile and not tile.get("children"):
        yield tile["content"]["uri"], matrix
    for child in tile.get("children", []):
        yield from leaves(child, matrix)


def by_tiles(name):
    convert(name, outfolder="tiles", jobs=1, use_process_pool=False, extra_fields=["intensity"])
    found = []
    for uri, matrix in leaves(json.loads(Path("tiles/tileset.json").read_text())["root"], np.eye(4)):
        body = read_binary_tile_content(Path("tiles") / uri).body
        xyz = body.feature_table.body.position.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        red = body.feature_table.body.color.reshape(-1, 3)[:, 0]
        found.append(np.c_[xyz, red, body.batch_table.get_binary_property("intensity")])
    shutil.rmtree("tiles")
    found = np.concatenate(found)
    return found[np.argsort(found[:, 0])]


lines = [f"{x:.3f} {y:.3f} {z:.3f} {10 * i} 128 128 128\n" for i, (x, y, z) in enumerate(places)]
Path("cloud.xyz").write_text("".join(lines))
kinds = [*((axis, "f8") for axis in "xyz"), *((colour, "f4") for colour in ("red", "green", "blue")), ("intensity", "f4")]
rows = np.array([(*place, 0.5, 0.5, 0.5, 10.0 * i) for i, place in enumerate(places)], kinds)
plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write("cloud.ply")
text, ply = by_tiles("cloud.xyz"), by_tiles("cloud.ply")
print("py3dtiles", version("py3dtiles"), "y of 100 points a centimetre apart: from text", np.unique(text[:, 1]), "off by up to", np.abs(text[:, 1] - places[:, 1]).max())
print("from PLY off by up to", np.abs(ply[:, :3] - places).max(), "intensity 300:", text[30, 4], ply[30, 4], "colour 0.5 of PLY:", set(ply[:, 3].tolist()))
assert len(text) == len(ply) == 100 and np.abs(ply[:, :3] - places).max() < 1e-4
assert len(np.unique(text[:, 1])) == 3, "the precision of text has changed"
assert text[30, 4] == 44 and ply[30, 4] == 300, "the intensities have changed"
assert text[0, 3] == 128 and not ply[:, 3].any(), "the colours have changed"
PY
v/bin/python look.py > out.txt; grep -v '^$' out.txt | tail -2
