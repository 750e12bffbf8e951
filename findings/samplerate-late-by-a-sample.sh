#!/usr/bin/env bash
# A good guess: python-samplerate's converters, libsamplerate's, put a signal where it was, whichever is chosen, and at a ratio of 1 give it back.
# Found: "linear" and "zero_order_hold" are a whole sample of the input late, at any ratio: 0, 1, 2, 3 becomes 0, 0, 1, 2, and the last value is
# lost; a position recorded at 1 kHz and brought to a camera's clock so is 1 ms behind. The "sinc" ones are in time, to a ten-thousandth, but take
# what is before and after the signal for 0: at half the rate a constant 1 begins with 0.74, 1.08, 0.95.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps samplerate==0.2.4 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import samplerate

ramp = np.arange(1000, dtype=np.float32)
seconds = np.arange(2000) / 1000
late, first = {}, {}
for kind in ("sinc_best", "sinc_fastest", "linear", "zero_order_hold"):
    first[kind] = [round(float(value), 2) for value in samplerate.resample(ramp, 1.0, kind)[:4]]
    late[kind] = {}
    for ratio in (0.5, 1.0, 2.0, 4.0):
        made = samplerate.resample(ramp, ratio, kind)
        late[kind][ratio] = round(float(500 - made[int(500 * ratio)]), 3)
    print("samplerate", version("samplerate"), f"{kind}: samples late at ratios {late[kind]}; 0, 1, 2, 3 at a ratio of 1: {first[kind]}")
path = np.sin(2 * np.pi * 5 * seconds).astype(np.float32)
made = samplerate.resample(path, 10, "linear")
inner = slice(5000, 15000)
phase = np.angle(np.vdot(np.exp(2j * np.pi * 5 * np.arange(len(made)) / 10000)[inner], made[inner])) + np.pi / 2
delay = -phase / (2 * np.pi * 5) * 1e3
constant = [round(float(value), 2) for value in samplerate.resample(np.ones(1000, dtype=np.float32), 0.5, "sinc_best")[:3]]
print(f"a path of 5 Hz at 1 kHz, by linear to 10 kHz: {delay:.3f} ms late; a constant 1, by sinc_best to half the rate, begins with {constant}")
assert all(abs(by) < 0.01 for kind in ("sinc_best", "sinc_fastest") for by in late[kind].values())
assert all(by == 1 for kind in ("linear", "zero_order_hold") for by in late[kind].values()), "the behaviour has changed"
assert first["linear"] == first["zero_order_hold"] == [0, 0, 1, 2] and abs(delay - 1) < 0.01, "the behaviour has changed"
assert np.allclose(constant, [0.74, 1.08, 0.95], atol=0.02), "ends: the behaviour has changed"
PY
