#!/usr/bin/env bash
# A good guess: torchmetrics' relative average spectral error (RASE) is what its reference defines, 100 over the mean of the truth times the
# root mean square error: 20 for pictures of 0.5 that are 0.1 too bright. Found: the mean is divided by the window's area a second time, so
# that the figure is 64 times too large with the default window of 8, and depends on the window where nothing varies: 320, 1280, 5120 for
# windows of 4, 8, 16. Tables of fused spectral pictures that mix it with sewar's are of two measures.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check torchmetrics==1.9.0 torch==2.14.1 numpy==2.4.6 sewar==0.4.10
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import sewar
import torch
from torchmetrics.functional.image import relative_average_spectral_error

truth = torch.full((1, 3, 40, 40), 0.5)
by_definition = 100 / 0.5 * 0.1
other = sewar.rase(np.full((40, 40, 3), 0.5), np.full((40, 40, 3), 0.6))
print(f"by the definition {by_definition:.1f}, sewar {version('sewar')} {other:.1f}")
times = {}
for window in (4, 8, 16):
    found = relative_average_spectral_error(truth + 0.1, truth, window_size=window).item()
    print("torchmetrics", version("torchmetrics"), f"window {window}: {found:.0f}")
    times[window] = found / by_definition
assert all(abs(found - window**2) < 0.01 * window**2 for window, found in times.items()), "the behaviour has changed"
PY
