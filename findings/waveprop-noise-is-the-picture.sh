#!/usr/bin/env bash
# A good guess: add_shot_noise(picture, snr_db) of waveprop, with which measurements of lensless cameras are simulated, adds noise of mean 0, so
# many dB below the picture. Found: what it adds is a draw of Poisson's distribution itself, not its difference to the picture, scaled until its
# variance is that many dB below: mostly the picture once more. Of counts up to 4000 at 40 dB, the result is 1.01 times the picture with noise
# at 60 dB, at 10 dB 1.3 times the picture with noise beyond 30 dB, and methods look that much more robust. Draw poisson(picture) yourself,
# or subtract the picture before scaling.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check scipy==1.17.1 torch==2.13.0 numpy==2.4.6
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps waveprop==0.0.12
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from waveprop.noise import add_shot_noise

np.random.seed(0)
found = {}
for full in (1, 255, 4000):
    picture = np.random.uniform(0.5 * full, full, (256, 256))
    for asked in (10, 40):
        result = add_shot_noise(picture.copy(), asked)
        slope, _ = np.polyfit(picture.ravel(), result.ravel(), 1)
        noise = result - slope * picture
        got = 10 * np.log10(slope**2 * picture.var() / noise.var())
        found[full, asked] = float(result.mean() / picture.mean()), float(got)
        print(f"waveprop {version('waveprop')} up to {full}, {asked} dB asked: {found[full, asked][0]:.3f} times the picture's mean, noise at {got:.1f} dB")
assert found[4000, 40][1] > 58 and found[4000, 10][1] > 28, "the behaviour has changed"
assert 1.25 < found[4000, 10][0] < 1.4 and found[255, 10][0] > 1.25, "the mean: the behaviour has changed"
PY
