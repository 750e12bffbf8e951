#!/usr/bin/env bash
# A good guess: pypcd4 keeps the colours of a point cloud in each encoding of PCD files that it writes. Found: colours are bytes in the bits of
# a float, as PCD has them, and that float (of the order of 1e-38) is written as text with ten digits after the point: every point of an ASCII
# file is black. Both binary encodings keep them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pypcd4==1.5.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pypcd4 import Encoding, PointCloud

colours = np.array([[255, 0, 0], [1, 2, 3], [10, 200, 30]], np.uint8)
places = np.arange(9, dtype=np.float32).reshape(3, 3)
cloud = PointCloud.from_xyzrgb_points(np.hstack([places, PointCloud.encode_rgb(colours).reshape(-1, 1)]))
found = {}
for encoding in (Encoding.BINARY, Encoding.BINARY_COMPRESSED, Encoding.ASCII):
    cloud.save("cloud.pcd", encoding=encoding)
    found[encoding] = PointCloud.decode_rgb(PointCloud.from_path("cloud.pcd").pc_data["rgb"]).tolist()
    print("pypcd4", version("pypcd4"), encoding.name, found[encoding])
assert found[Encoding.BINARY] == found[Encoding.BINARY_COMPRESSED] == colours.tolist()
assert found[Encoding.ASCII] == [[0, 0, 0]] * 3, "the behaviour has changed"
PY
