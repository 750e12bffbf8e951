#!/usr/bin/env bash
# A good guess: PyMoDAQ's ift() takes back what its ft() did: the page of each says that the "default is the last" axis, and to use them with the axes
# of ftAxis(). Found: ift() goes along the first axis, so that of a stack of traces nothing comes back. One trace of odd length comes back
# complex, and moved by a sample. And of even length the constant part lies half a step beside zero on ftAxis()'s frequencies, which have none.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps pymodaq_utils==5.3.7 numpy==2.4.6 pint==0.25.3 fasteners==0.20
v/bin/pip install --quiet --disable-pip-version-check --no-deps toml==0.10.2 flexparser==0.4 flexcache==0.3 platformdirs==4.14.9 typing_extensions==4.16.0
HOME=$folder v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from pymodaq_utils.math_utils import ft, ftAxis, ift

print("pymodaq_utils", version("pymodaq_utils"))
for transform in (ft, ift):
    assert "default is the last of the array" in transform.__doc__, "the pages: the behaviour has changed"
traces = np.random.default_rng(0).random((4, 8))
off = [np.abs(back - traces).max() for back in (ift(ft(traces)), ift(ft(traces), dim=-1))]
print("a stack of four traces of eight samples, off at most, there and back:", off[0], "with dim=-1:", off[1])
assert off[0] > 0.1 and off[1] < 1e-12, "stacks: the behaviour has changed"
back = {length: ift(ft(np.arange(float(length)))).round(3) for length in (8, 7)}
print("0, 1, 2, ... of eight and seven samples come back as", back[8], back[7])
assert np.array_equal(back[8], np.arange(8)), "even lengths: the behaviour has changed"
assert np.allclose(abs(back[7]), np.roll(np.arange(7), -1), atol=0.01), "odd lengths: the behaviour has changed"
assert abs(back[7].imag).max() > 1, "odd lengths: the behaviour has changed"
frequencies, _ = ftAxis(8, 4.0)
line = frequencies[np.argmax(np.abs(ft(np.ones(8))))]
print("frequencies", frequencies, "that of a constant:", line)
assert abs(frequencies).min() > 0.5 and np.isclose(abs(line), (frequencies[1] - frequencies[0]) / 2), "frequencies: the behaviour has changed"
PY
