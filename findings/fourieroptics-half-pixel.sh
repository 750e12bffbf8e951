#!/usr/bin/env bash
# A good guess: fourieroptics' four ways to propagate a field by z, by a transfer function (TF) or an impulse response (IR), agree where both are
# sampled well, and leave a beam on its axis, for odd sizes too. Found: the impulse response of Fresnel lies on another grid, of M points from
# -L/2 to L/2: the beam moves by half a pixel to the upper left, and 1 % of its light is lost and more scattered. For odd sizes both transfer
# functions tilt, by half a pixel for 4 cm here, a whole one for 8. For pixels less than half a wavelength, TF_RayleighSommerfeld is all NaN.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check fourieroptics==0.0.5 scipy==1.17.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from fourieroptics import propagators

side, wavelength, waist = 2e-3, 0.5e-6, 0.1e-3
found = {}
for size in (200, 201):
    x = (np.arange(size) - size // 2) * side / size
    beam = np.exp(-(x[:, None] ** 2 + x**2) / waist**2)
    for z in (0.04, 0.08):
        width = waist / 2 * np.hypot(1, z * wavelength / (np.pi * waist**2))
        for name in ("TF_Fresnel", "IR_Fresnel", "TF_RayleighSommerfeld", "IR_RayleighSommerfeld"):
            light = abs(getattr(propagators, f"prop{name}")(beam, side, wavelength, z)) ** 2
            centre = (light.sum(0) * x).sum() / light.sum()
            spread = np.sqrt((light.sum(0) * (x - centre) ** 2).sum() / light.sum())
            found[name, size, z] = centre / (side / size), spread / width, light.sum() / (beam**2).sum()
            print("fourieroptics", version("fourieroptics"), f"{name} of {size} pixels by {z} m: centre {found[name, size, z][0]:+.3f} pixels, {found[name, size, z][1]:.4f} times as wide as it should be, {found[name, size, z][2]:.4f} of the light")
centre, width, light = zip(*found.values())
centre, width, light = (dict(zip(found, each)) for each in (centre, width, light))
for name in ("TF_Fresnel", "TF_RayleighSommerfeld", "IR_RayleighSommerfeld"):
    assert abs(centre[name, 200, 0.04]) < 1e-3 and abs(width[name, 200, 0.04] - 1) < 1e-3 and abs(light[name, 200, 0.04] - 1) < 1e-3
for z in (0.04, 0.08):
    assert abs(centre["IR_Fresnel", 200, z] + 0.5) < 1e-3, "IR_Fresnel: the behaviour has changed"
    assert width["IR_Fresnel", 200, z] > 1.2 and light["IR_Fresnel", 200, z] < 0.995, "IR_Fresnel: the behaviour has changed"
    for name in ("TF_Fresnel", "TF_RayleighSommerfeld"):
        assert abs(centre[name, 201, z] - z / 0.08) < 0.02, "odd sizes: the behaviour has changed"
point = np.zeros((32, 32))
point[16, 16] = 1
bad = {pixel: float(np.isnan(propagators.propTF_RayleighSommerfeld(point, 32 * pixel, wavelength, 1e-5)).mean()) for pixel in (0.4e-6, 0.24e-6)}
print("TF_RayleighSommerfeld: share of NaN by pixel", bad)
assert bad == {0.4e-6: 0, 0.24e-6: 1}, "small pixels: the behaviour has changed"
PY
