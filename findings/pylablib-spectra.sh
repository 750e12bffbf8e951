#!/usr/bin/env bash
# A good guess: pylablib's one-sided power spectral density of a trace is SciPy's, and its sum times the step of the frequency is the trace's
# variance, as its page has it for this normalization. Found: half of it: what lay at negative frequencies is left out, not added; and with
# truncate=True, which shortens a trace to a length that is fast to transform, the density's axis of frequencies is still of the whole
# length: a line at 200 Hz lies at 197.9, in the Fourier transform of the same trace at 200.4. Two-sided and untruncated it is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pylablib-lightweight==1.4.3 numpy==1.26.4 scipy==1.15.3 pandas==2.3.3
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from pylablib.core.dataproc.fourier import fourier_transform, power_spectral_density
from scipy import signal

noise = np.random.default_rng(7).normal(size=100_000)
noise -= noise.mean()
one_sided = power_spectral_density(noise, dt=1e-3, single_sided=True)
two_sided = power_spectral_density(noise, dt=1e-3)
frequencies, scipys = signal.periodogram(noise, 1000.0)
step = frequencies[1]
power = {"pylablib, one side": one_sided[:, 1].sum() * step, "both": two_sided[:, 1].sum() * step, "SciPy, one side": scipys.sum() * step}
power = {name: round(float(value), 3) for name, value in power.items()}


def line(spectrum):
    above = spectrum[spectrum[:, 0].real > 20]
    return round(float(above[abs(above[:, 1]).argmax(), 0].real), 2)


time_s = np.arange(1021) / 1000
trace = np.column_stack([time_s, np.sin(2 * np.pi * 200 * time_s)])
seen = {kind.__name__: [line(kind(trace, truncate=cut)) for cut in (False, True)] for kind in (power_spectral_density, fourier_transform)}
print("pylablib", version("pylablib-lightweight"), "power of noise of variance", round(float(noise.var()), 3), power)
print("a line at 200 Hz, whole and truncated", seen)
assert abs(power["pylablib, one side"] / power["SciPy, one side"] - 0.5) < 0.005, "one side: the behaviour has changed"
assert abs(power["both"] - noise.var()) < 0.005, "both sides: the behaviour has changed"
assert seen["power_spectral_density"][1] < 198.5, "truncated: the behaviour has changed"
assert all(abs(value - 200) < 0.5 for value in (*seen["fourier_transform"], seen["power_spectral_density"][0])), "what is right has changed"
PY
