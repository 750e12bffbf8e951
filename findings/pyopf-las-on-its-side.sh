#!/usr/bin/env bash
# A good guess: Pix4D's converters of its open format (pyopf) to LAS and PLY undo the turn of axes that glTF asks of it, as its converter to COLMAP does, and LAS's colours
# fill 16 bits, as LAS asks. Found: heights stay in y and norths, negated, in z: the cloud lies on its side; white is 255 of 65535; and coordinates, which the format counts
# from a shifted origin, are written unshifted under the whole system of coordinates: a place in Bern is found 1200 km south of it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyopf[tools]==1.4.1 numpy==2.3.5
cat > look.py <<'PY'
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import laspy
import numpy as np
import plyfile
from opf_tools.opf2colmap.converter import generate_points3D
from opf_tools.opf2las import converter as to_las
from opf_tools.opf2ply.converter import gltf_to_ply
from pyopf.crs import BaseToTranslatedCanonicalCrsTransform, Crs, SceneReferenceFrame
from pyopf.pointcloud import GlTFPointCloud
from pyopf.pointcloud.pcl import Node, opf_axis_rotation_matrix
from pyproj import CRS

place = (10.0, 20.0, 500.0)  # east, north, up, from an origin in Bern
node = Node()
node.position = np.array([place], np.float32)
node.color = np.full((1, 4), 255, np.uint8)
node.matrix = opf_axis_rotation_matrix  # what pyopf itself gives the clouds that it merges
cloud = GlTFPointCloud()
cloud.nodes = [node]
cloud.write(Path("cloud.gltf"))
opened = GlTFPointCloud.open(Path("cloud.gltf"))

frame = SceneReferenceFrame(
    BaseToTranslatedCanonicalCrsTransform(scale=np.ones(3), shift=np.array([-2600000.0, -1200000.0, 0]), swap_xy=False),
    Crs(CRS("EPSG:2056").to_wkt()),
)
to_las.gltf_to_las(opened, Path("cloud.las"), frame.crs)  # as its main() calls it
gltf_to_ply(opened, Path("cloud.ply"))
project = SimpleNamespace(calibration=SimpleNamespace(tracks=opened))
generate_points3D(project, {}, [([], [])], {"out_dir": "."})
las = laspy.read("cloud.las")
ply = plyfile.PlyData.read("cloud.ply")["vertex"].data[0]
colmap = [float(number) for number in Path("points3D.txt").read_text().splitlines()[-1].split()[1:4]]
print("pyopf", version("pyopf"), "east, north, up", place, "in LAS", las.xyz[0].tolist(), "PLY", [float(n) for n in ply.tolist()[:3]], "COLMAP", colmap)
print("white in LAS:", int(las.red[0]), "system of coordinates:", las.header.parse_crs().name)
assert colmap == list(place)
assert np.allclose(las.xyz[0], [10, 500, -20]) and list(ply.tolist()[:3]) == [10, 500, -20], "the axes have changed"
assert las.red[0] == 255, "the colours have changed"
assert las.header.parse_crs().to_epsg() == 2056, "the system of coordinates has changed"
PY
v/bin/python look.py
