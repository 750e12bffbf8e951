#!/usr/bin/env bash
# A good guess: build-color's dominant_wavelength gives back the wavelength of light of one wavelength, and its tone mapping for displays, BT.2390,
# gives no more than the display's peak and keeps the order of brightness. Found: light of 600 nm has a dominant wavelength of 775 nm,
# 560 has 525, 460 has 420: it takes the farthest point of the spectrum in that direction, not the one in line. On a display of
# 1000 cd/m2, 2000 become 1996, and 4000 become 1000: brighter is darker. Its Khronos PBR Neutral makes 0.33 of 0.5, where Khronos has 0.46.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check build-color==1.0.2 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from build_color import spectral, tonemap

name = f"build-color {version('build-color')}"
found = {}
for wavelength in (460, 520, 560, 600):
    at = list(spectral.CMF_WAVELENGTHS).index(wavelength)
    xyz = np.array([spectral.CMF_X[at], spectral.CMF_Y[at], spectral.CMF_Z[at]])
    x, y = (xyz / xyz.sum())[:2]
    found[wavelength] = float(spectral.dominant_wavelength(x, y))
    print(name, f"light of {wavelength} nm (x {x:.4f}, y {y:.4f}) has a dominant wavelength of {found[wavelength]:g} nm")
light = np.array([100.0, 500, 1000, 2000, 3000, 4000])
shown = tonemap.bt2390_eetf(light, source_peak=4000, target_peak=1000)
neutral = float(tonemap.pbr_neutral(np.full((1, 3), 0.5))[0, 0])
print(name, "BT.2390 from 4000 to 1000 cd/m2:", dict(zip(light.tolist(), shown.round(1).tolist())), f"; PBR Neutral of 0.5 is {neutral:.3f}")
assert found[520] == 520 and np.allclose(shown[:2], light[:2])
assert (found[460], found[560], found[600]) == (420, 525, 775), "wavelengths: the behaviour has changed"
assert shown[3] > 1900 and shown[3] > shown[4] > shown[5] and abs(shown[5] - 1000) < 1, "BT.2390: the behaviour has changed"
assert abs(neutral - 1 / 3) < 1e-9, "PBR Neutral: the behaviour has changed"
PY
