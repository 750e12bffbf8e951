#!/usr/bin/env bash
# A good guess: PyMeasure reads a Red Pitaya's buffer of samples in its faster, binary format as in text: as many samples, the same volts.
# Found: it takes the bytes for whole numbers of the computer's own kind, 64 bits and the lower byte first, where the board sends 16 bits a
# sample (RAW) or 32-bit floats (VOLTS), the upper byte first (so its maker's own Python reads them): a quarter or half as many samples come,
# of up to 10^14 volts. In text both are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps pymeasure==0.16.0 numpy==2.4.6 pyvisa==1.16.2 pyserial==3.5
v/bin/pip install --quiet --disable-pip-version-check --no-deps pint==0.25.3 flexparser==0.4 flexcache==0.3 platformdirs==4.14.9 typing_extensions==4.16.0
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pymeasure.adapters import ProtocolAdapter
from pymeasure.instruments.redpitaya import RedPitayaScpi

volts = np.linspace(-1, 1, 16)


def read(answer, kind):
    """Return what the driver reads of the board's answer; after binary ones it asks for the range."""
    asked = [("ACQ:SOUR1:DATA?", answer)] + ([("ACQ:SOUR1:GAIN?", "LV")] if kind == "BIN" else [])
    return RedPitayaScpi(ProtocolAdapter(asked)).ain1.get_data(format=kind)


def block(samples):
    return b"#2%d" % samples.nbytes + samples.tobytes() + b"\r\n"


text = read("{" + ",".join(f"{value:.6f}" for value in volts) + "}", "ASCII")
raw = read(block(np.round(volts * 8191).astype(">i2")), "BIN")
floats = read(block(volts.astype(">f4")), "BIN")
print("pymeasure", version("pymeasure"), "of 16 samples from -1 to 1 V reads in text", text.size, "from", text.min(), "to", text.max())
for name, found in (("raw", raw), ("floats", floats)):
    print("binary,", name + ":", found.size, "samples, the largest", np.abs(found).max(), "V")
assert np.allclose(text, volts, atol=1e-6), "text: the behaviour has changed"
assert raw.size == 4 and floats.size == 8, "binary samples: the behaviour has changed"
assert min(np.abs(raw).max(), np.abs(floats).max()) > 1e12, "binary volts: the behaviour has changed"
PY
