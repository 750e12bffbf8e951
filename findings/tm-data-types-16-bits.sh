#!/usr/bin/env bash
# A good guess: tm_data_types, Tektronix's own library for waveforms, reads from CSV and MATLAB files the floats that are in them, as it does from
# its WFM files. Found: it stretches them to 16 bits between their least and greatest value. Beside a pulse of 100 V, 0, 1 and 2 mV are
# read as 0.76, 2.29 and 2.29; the files have them right. And into MATLAB files it writes volts as the horizontal and seconds as
# the vertical unit; it reads its own back the right way round.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check tm-data-types==0.5.0 numpy==1.26.4
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import scipy.io
from tm_data_types import AnalogWaveform, read_file, write_file

volts = np.array([0.0, 0.001, 0.002, 0.001, 0.0, 100.0, 0.0, 0.001], np.float32)
read = {}
for kind in ("wfm", "csv", "mat"):
    trace = AnalogWaveform()
    trace.y_axis_values, trace.x_axis_spacing, trace.trigger_index = volts, 1e-3, 0.0
    write_file(f"trace.{kind}", trace)
    back = read_file(f"trace.{kind}")
    read[kind] = np.array(back.normalized_vertical_values, float)
    print("tm_data_types", version("tm-data-types"), kind, back.y_axis_values.dtype, np.round(1000 * read[kind], 3), "mV")
lines = Path("trace.csv").read_text().splitlines()
written = np.array([line.split(",")[1] for line in lines[-len(volts) :]], float)
in_matlab = [value for value in scipy.io.loadmat("trace.mat").values() if len(volts) in getattr(value, "shape", ())]
assert np.allclose(read["wfm"], volts, atol=1e-9), "WFM: the behaviour has changed"
assert np.allclose(written, volts, atol=1e-6), "the CSV file: the behaviour has changed"
assert np.allclose(np.ravel(in_matlab[0]), volts, atol=1e-9), "the MATLAB file: the behaviour has changed"
print("in the files:", written)
for kind in ("csv", "mat"):
    assert np.allclose(1000 * read[kind][:4], [0.763, 2.289, 2.289, 2.289], atol=0.001), f"{kind}: the behaviour has changed"
units = [str(np.ravel(scipy.io.loadmat("trace.mat")[name])[0]) for name in ("horizontalUnits", "verticalUnits")]
print("units in the MATLAB file, horizontal and vertical:", units, "read back:", back.x_axis_units, back.y_axis_units)
assert units == ["V", "s"], "units: the behaviour has changed"
assert (back.x_axis_units, back.y_axis_units) == ("s", "V"), "units read: the behaviour has changed"
PY
