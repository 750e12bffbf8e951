#!/usr/bin/env bash
# A good guess: slm-dmd-linux (slmscreen), by whose word holograms with encoding="amplitude" give "cleaner modes" than those of phase alone, puts the mode
# that is asked for into the first order. Found: the phase that a shallower blaze gives the first order is added once more instead of taken
# off, so that phase follows amplitude: of three LG modes, lit evenly, 16, 20 and 32 % of the order's light are in the mode, where phase
# alone has 16, 24 and 26. With that sign turned there are 99.7 % and more, and its binary holograms for a DMD have 93 to 99.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps slm-dmd-linux==0.1.0 numpy==2.4.6 scipy==1.17.1
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from slmscreen import patterns

SIZE, PERIOD, WAIST = 256, 8, 32.0


def share(shown, mode):
    """Return the share of the light in the first order, of what is shown under even light, that is in the mode."""
    rows, columns = np.meshgrid(np.fft.fftfreq(SIZE), np.fft.fftfreq(SIZE), indexing="ij")
    order = np.fft.fft2(shown) * (np.hypot(rows, columns - 1 / PERIOD) < 0.35 / PERIOD)
    field = np.fft.ifft2(order) * np.exp(-2j * np.pi * (np.arange(SIZE) - SIZE // 2) / PERIOD)
    return abs(np.vdot(mode, field)) ** 2 / (np.vdot(mode, mode).real * np.vdot(field, field).real)


def light(levels):
    """Return the light behind a display on which 255 are one wave."""
    return np.exp(2j * np.pi * levels / 255)


carrier = patterns.grating_phase(SIZE, SIZE, PERIOD)
found = {}
for ell, p in ((1, 0), (3, 0), (1, 1)):
    mode = patterns.lg_field(SIZE, SIZE, ell, p, WAIST)
    fill = {"ell": ell, "p": p, "waist_px": WAIST, "period_px": PERIOD}
    # The same steps with the sign that takes the phase of the shallower blaze off.
    depth = np.interp(np.abs(mode), np.sinc(1 - np.linspace(0, 1, 2048)), np.linspace(0, 1, 2048))
    turned = depth * np.mod(np.angle(mode) + carrier + np.pi * (1 - depth), 2 * np.pi)
    found[ell, p] = {
        "phase": share(light(patterns.oam_hologram(SIZE, SIZE, encoding="phase", **fill)), mode),
        "amplitude": share(light(patterns.oam_hologram(SIZE, SIZE, encoding="amplitude", **fill)), mode),
        "amplitude, sign turned": share(light(patterns.to_grey(turned)), mode),
        "binary": share(patterns.lee_hologram(SIZE, SIZE, **fill) / 255.0, mode),
    }
    print("slm-dmd-linux", version("slm-dmd-linux"), f"LG l {ell} p {p}: share of the first order in the mode,", {name: round(float(value), 3) for name, value in found[ell, p].items()})
assert all(each["amplitude, sign turned"] > 0.99 and each["binary"] > 0.88 for each in found.values())
assert all(each["amplitude"] < 0.35 for each in found.values()), "the behaviour has changed"
assert any(each["amplitude"] < each["phase"] for each in found.values()), "the behaviour has changed"
PY
