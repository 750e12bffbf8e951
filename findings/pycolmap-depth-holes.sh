#!/usr/bin/env bash
# A good guess: pycolmap's DepthMap, in which 0 means that nothing was found, is rescaled by nearest depths, or without the holes. Found: rescale() and
# downsize() interpolate over them: beside a hole a wall at 4 m comes to 2 m, as if something stood there, and the hole itself to half a
# millimetre, which is above 0 and so passes for a measurement. Between things at 4 m and 8 m lies a third one at 6 m.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pycolmap==4.2.1 numpy==2.4.6
cat > look.py <<'PY'
import numpy as np
import pycolmap

depth = np.zeros((4, 8), np.float32)
depth[:, 3:] = 4
depth[:, 5:] = 8
small = {}
for name in ("rescale", "downsize"):
    kept = pycolmap.DepthMap.from_array(depth, 0.1, 10.0)
    kept.rescale(0.5) if name == "rescale" else kept.downsize(4, 2)
    small[name] = kept.to_array()
    assert small[name].shape == (2, 4)
print("pycolmap", pycolmap.__version__, "depth", depth[0].tolist())
for name, values in small.items():
    print(name, values[0].round(4).tolist(), "above 0:", int((values > 0).sum()), "of", values.size, "and", int((depth > 0).sum()), "of", depth.size, "before")
values = np.stack(list(small.values()))
assert np.all(values > 0) and np.all(values[:, 0, 0] < 0.01), "the behaviour has changed"
assert np.allclose(values[:, 0, 1:3], [2, 6], atol=0.1), "the behaviour has changed"
PY
v/bin/python look.py
