#!/usr/bin/env bash
# A good guess: viser sends splats to its page in the single precision of their file. Found: covariances go as 16-bit floats. In metres, Gaussians
# of 0.1 mm standard deviation have a covariance of nothing, those of 1 mm one that is 2 % off, and in millimetres those of 256 mm are infinite.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check viser==1.1.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import viser

deviations = np.array([1e-4, 1e-3, 0.1, 300.0])
server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
count = len(deviations)
sent = server.scene.add_gaussian_splats(
    "/scene",
    centers=np.zeros((count, 3), np.float32),
    covariances=np.eye(3, dtype=np.float32) * (deviations**2)[:, None, None].astype(np.float32),
    rgbs=np.ones((count, 3), np.float32),
    opacities=np.ones((count, 1), np.float32),
)
covariances = sent.buffer.view(np.float16).reshape(count, 16)[:, 8:14].astype(float)
variances = covariances[:, 0]  # xx of xx, xy, xz, yy, yz, zz
server.stop()
print("viser", version("viser"), "standard deviations", deviations, "become", np.sqrt(variances))
assert variances[0] == 0 and 0.005 < abs(variances[1] / 1e-6 - 1) < 0.05, "the behaviour has changed"
assert abs(variances[2] / 0.01 - 1) < 1e-3 and np.isinf(variances[3]), "the behaviour has changed"
PY
