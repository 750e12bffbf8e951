#!/usr/bin/env bash
# A good guess: diffractio's gauss_beam() at a distance z0 from the waist is the beam that its own propagation makes of the waist: as bright, and
# straight ahead from r0. Found: a Rayleigh length from the waist it has half of the light, since both axes' widths divide the amplitude; its
# wavefronts are curved about the axis even when r0 is not on it, so that the beam of r0 = (30, 0) um runs to x = 15 towards its waist and to 45 behind
# it; and an angle alpha turns r0 as well: (30, 0) by 90 degrees lies at (0, 30).
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check numpy==1.26.4 scipy==1.15.3 matplotlib==3.10.7 pandas==2.3.3 ezdxf==1.4.3 psutil==7.2.2 pillow==12.0.0
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps diffractio==1.0.0
OMP_NUM_THREADS=1 MPLBACKEND=agg v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from diffractio.scalar_sources_XY import Scalar_source_XY

x = np.linspace(-100, 100, 201)
wavelength, waist = 0.5, 10.0
rayleigh = np.pi * waist**2 / wavelength


def beam(place, distance, **kind):
    field = Scalar_source_XY(x, x, wavelength)
    field.gauss_beam(**{"r0": place, "w0": waist, "z0": distance} | kind)
    return field


def seen(field):
    """Return where a field's light lies, how wide it is along x, and how much there is, of that in the waist."""
    light = np.abs(field.u) ** 2
    centre = [(light * each).sum() / light.sum() for each in (field.X, field.Y)]
    return np.round(centre, 2).tolist(), round(2 * np.sqrt((light * (field.X - centre[0]) ** 2).sum() / light.sum()), 2), round(light.sum() / full, 3)


full = (np.abs(beam((0.0, 0.0), 0.0).u) ** 2).sum()
found = {
    "the waist at (30, 0), propagated": seen(beam((30.0, 0.0), 0.0).RS(z=rayleigh, new_field=True, verbose=False)),
    "a beam at (30, 0), a Rayleigh length off": seen(beam((30.0, 0.0), rayleigh)),
    "that beam, propagated to its waist": seen(beam((30.0, 0.0), rayleigh).RS(z=rayleigh, new_field=True, verbose=False)),
    "one behind its waist, propagated": seen(beam((30.0, 0.0), -rayleigh).RS(z=rayleigh, new_field=True, verbose=False)),
    "one on the axis, propagated to its waist": seen(beam((0.0, 0.0), rayleigh).RS(z=rayleigh, new_field=True, verbose=False)),
    "an elliptical one at (30, 0)": seen(beam((30.0, 0.0), 0.0, w0=(10.0, 15.0))),
    "an elliptical one at (30, 0), turned by 90 degrees": seen(beam((30.0, 0.0), 0.0, w0=(10.0, 15.0), alpha=np.pi / 2)),
}
for name, (centre, width, light) in found.items():
    print("diffractio", version("diffractio"), f"{name}: lies at {centre}, half width {width}, light {light}")
(straight, off, to_waist, behind, on_axis, elliptical, turned) = found.values()
assert straight[0] == [30, 0] and abs(straight[1] - waist * np.sqrt(2)) < 0.05 and abs(straight[2] - 1) < 0.02
assert on_axis[0] == [0, 0] and abs(on_axis[1] - waist) < 0.05 and elliptical[:2] == ([30, 0], 10)
assert off[0] == [30, 0] and abs(off[1] - waist * np.sqrt(2)) < 0.05
assert abs(off[2] - 0.5) < 0.01 and abs(to_waist[0][0] - 15) < 0.1 and abs(behind[0][0] - 45) < 0.1, "the behaviour has changed"
assert turned[:2] == ([0, 30], 15), "turns: the behaviour has changed"
PY
