#!/usr/bin/env bash
# A good guess: the package psf-generator makes a point spread function of the aperture that it is given, in planes and pixels of the steps that it
# is given, and one plane is in focus. Found: it divides the aperture by the index that the objective was designed for, n_i0, which is 1.5 unless
# told: with n_i = 1 and nothing else, air at NA 0.5 is as wide as at 0.33; with gibson_lanni the aperture becomes less by n_s / n_i. The
# planes' steps and the pixels are larger by n / (n - 1): three planes with steps of 400 nm lie 600 nm apart, two lie 400 nm on both sides of the
# focus, and a single one lies half a step beside it. Set n_i0 to n_i, defocus_step to (n - 1) / n of the step and to 0 for one plane.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check psf-generator==0.1.0 zernikepy==0.0.5 torch==2.13.0 numpy==2.4.6 scipy==1.17.1
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from psf_generator import ScalarCartesianPropagator as Cartesian
from psf_generator import ScalarSphericalPropagator as Spherical

WAVELENGTH, APERTURE, PIXELS, PIXEL = 600, 0.5, 101, 20


def width(kind, **optics):
    """Full width at half maximum in nanometres, by the pixel that was asked for."""
    system = kind(n_pix_pupil=201, n_pix_psf=PIXELS, wavelength=WAVELENGTH, na=APERTURE, pix_size=PIXEL, **optics)
    row = (system.compute_focus_field().abs() ** 2).sum(1)[0, PIXELS // 2].numpy()
    half = row[PIXELS // 2 :] / row.max()
    last = int(np.nonzero(half > 0.5)[0][-1])
    return 2 * PIXEL * float(last + (half[last] - 0.5) / (half[last] - half[last + 1]))


expected = 0.514 * WAVELENGTH / APERTURE
found = {
    "oil": width(Cartesian, n_i=1.5),
    "air": width(Cartesian, n_i=1.0),
    "air, n_i0 = 1": width(Cartesian, n_i=1.0, n_i0=1.0),
    "air, by the other integral": width(Spherical, n_i=1.0),
    "oil on water, gibson_lanni": width(Cartesian, n_i=1.5, n_s=1.33, gibson_lanni=True, z_p=0.0),
}
print(f"psf-generator {version('psf-generator')} width of a spot at NA {APERTURE}, expected {expected:.0f} nm:")
for name, size in found.items():
    print(f"  {name}: {size:.0f} nm")
planes = {}
for count in (1, 2, 3, 5):
    system = Cartesian(n_pix_pupil=65, n_pix_psf=11, wavelength=WAVELENGTH, na=APERTURE, defocus_step=400, n_defocus=count)
    planes[count] = np.linspace(system.defocus_min, system.defocus_max, count).tolist()
    print(f"  {count} planes with steps of 400 nm: {planes[count]}")
assert abs(found["oil"] / expected - 1) < 0.05 and abs(found["air, n_i0 = 1"] / expected - 1) < 0.05, "the aperture is another"
assert 1.45 < found["air"] / expected < 1.55 and 1.45 < found["air, by the other integral"] / expected < 1.55, "air: the behaviour has changed"
assert abs(found["oil on water, gibson_lanni"] / found["oil"] - 1.5 / 1.33) < 0.02, "water: the behaviour has changed"
assert planes == {1: [-200], 2: [-400, 400], 3: [-600, 0, 600], 5: [-1000, -500, 0, 500, 1000]}, "planes: the behaviour has changed"
PY
