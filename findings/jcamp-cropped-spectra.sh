#!/usr/bin/env bash
# A good guess: a spectrum that jcamp has read, cropped and written again is the cropped one, and one at uneven wavelengths, as any grating
# spectrometer gives, comes back at these. Found: writing keeps the header's old ends: of 400 to 800 nm cropped to 500 to 600 nm all comes
# back stretched over 400 to 800, a line of 550 nm at 600. Uneven wavelengths are written as even ones: a line of 550 nm comes back at 499.
# Values have four digits after the point: absorbances below 0.00005 are 0. And for each point it prints a line.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps jcamp==1.3.2 numpy==2.4.6
v/bin/python - <<'PY'
from contextlib import redirect_stdout
from importlib.metadata import version
from io import StringIO

import jcamp
import numpy as np


def there_and_back(spectrum):
    """Return the spectrum as it is written and read, and how many lines were printed."""
    out = StringIO()
    with redirect_stdout(out):
        jcamp.writefile("spectrum.jdx", spectrum)
        read = jcamp.readfile("spectrum.jdx")
    return read, len(out.getvalue().splitlines())


def line(x, place):
    """Return a spectrum with one line."""
    return np.exp(-(((x - place) / 2) ** 2))


even = np.linspace(400, 800, 401)
whole, printed = there_and_back({"title": "lamp", "xunits": "NANOMETERS", "x": even, "y": line(even, 550)})
peaks = {"even, 550": whole["x"][whole["y"].argmax()]}
kept = (whole["x"] >= 500) & (whole["x"] <= 600)
cropped, _ = there_and_back({**whole, "x": whole["x"][kept], "y": whole["y"][kept]})
peaks["cropped, 550"] = cropped["x"][cropped["y"].argmax()]
uneven = 400 + 400 * np.linspace(0, 1, 401) ** 0.7
other, _ = there_and_back({"x": uneven, "y": line(uneven, 550)})
peaks["uneven, 550"] = other["x"][other["y"].argmax()]
faint, _ = there_and_back({"x": even, "y": np.linspace(0, 1e-4, 401)})
levels = np.unique(faint["y"]).tolist()
print("jcamp", version("jcamp"), "lines found at", {name: round(float(place), 1) for name, place in peaks.items()}, "nm; the cropped spectrum goes from", cropped["x"][0], "to", cropped["x"][-1], "; 401 values up to 0.0001 come back as", levels, "; lines printed for 401 points:", printed)
assert abs(peaks["even, 550"] - 550) < 0.01 and np.allclose(whole["y"], line(even, 550), atol=1e-4)
assert (cropped["x"][0], cropped["x"][-1]) == (400, 800) and abs(peaks["cropped, 550"] - 600) < 0.1, "cropped: the behaviour has changed"
assert abs(peaks["uneven, 550"] - 499) < 1, "uneven: the behaviour has changed"
assert levels == [0, 1e-4], "digits: the behaviour has changed"
assert printed >= 401, "prints: the behaviour has changed"
PY
