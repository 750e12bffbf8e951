#!/usr/bin/env bash
# A good guess: diffractio's cut_resample() cuts out the part of a mask within x_limits and y_limits, as it does when it is given a number of points,
# too; gratings are moved by their x0; and binarize(kind="phase") makes a phase of two levels. Found: without a number of points x_limits choose
# rows and y_limits columns, while the new x and y are right: of a circle at (20, -10) nothing is left, and a wide mask loses its shape. Sinusoidal,
# binary, Ronchi's and blazed gratings move by 2 x0. A phase binarized to 0 and pi becomes amplitudes of 0 and 3.14.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check numpy==1.26.4 scipy==1.15.3 matplotlib==3.10.7 pandas==2.3.3 ezdxf==1.4.3 psutil==7.2.2 pillow==12.0.0
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps diffractio==1.0.0
OMP_NUM_THREADS=1 MPLBACKEND=agg v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from diffractio.scalar_masks_XY import Scalar_mask_XY

x, y = np.linspace(-100, 100, 201), np.linspace(-50, 50, 101)
own = version("diffractio")


def mask(make, rows=x, **kind):
    new = Scalar_mask_XY(x, rows, 0.5)
    getattr(new, make)(**kind)
    return new


cuts = {}
for place in ((20, -10), (-10, 20)):
    circle = mask("circle", r0=place, radius=5)
    for points in (None, (41, 51)):
        part = circle.cut_resample(x_limits=(0, 40), y_limits=(-30, 20), num_points=points, new_field=True)
        cuts[place, points] = round(float(abs(part.u).sum())), part.u.shape
        print("diffractio", own, f"x 0 to 40, y -30 to 20, points {points}: of a circle at {place} of {abs(circle.u).sum():.0f} pixels {cuts[place, points][0]} are left; x, y and mask are", part.x.shape, part.y.shape, part.u.shape)
wide = mask("circle", y, r0=(20, -10), radius=5).cut_resample(x_limits=(0, 40), y_limits=(-30, 20), new_field=True)
print("cut out of 101 rows and 201 columns, the mask is", wide.u.shape)
moves = {}
for name, kind in (("blazed_grating", {"phase_max": 2 * np.pi}), ("sine_grating", {}), ("ronchi_grating", {}), ("binary_grating", {})):
    first = mask(name, period=50, x0=0, **kind).u[0]
    moves[name] = [each for each in range(1, 50) if np.allclose(mask(name, period=50, x0=10, **kind).u[0][each:], first[:-each], atol=1e-6)]
    print(name, "of period 50 and x0 = 10 is moved by", moves[name])
phase = Scalar_mask_XY(x, y, 0.5)
phase.u = np.exp(1j * np.linspace(-3, 3, 201)) * np.ones((101, 1))
levels = np.unique(phase.binarize(kind="phase", bin_level=0, level0=0, level1=np.pi, new_field=True).u.round(3))
print("a phase of levels 0 and pi:", levels.tolist())
assert cuts[(20, -10), (41, 51)][0] == 69 and cuts[(-10, 20), (41, 51)][0] == 0
assert cuts[(20, -10), None] == (0, (40, 50)) and cuts[(-10, 20), None][0] > 30, "cuts: the behaviour has changed"
assert wide.u.shape != (len(wide.y), len(wide.x)), "cuts: the behaviour has changed"
assert all(each == [20] for each in moves.values()), "gratings: the behaviour has changed"
assert np.allclose(levels, [0, 3.142]), "phases: the behaviour has changed"
PY
