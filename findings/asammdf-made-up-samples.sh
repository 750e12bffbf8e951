#!/usr/bin/env bash
# A good guess: asammdf's cut() of a recording from 0.25 to 0.65 s keeps the samples between these times, and its resample() interpolates all
# positions of a stage alike. Found: cut() adds a sample at each end that nobody recorded: a counter of frames has frame 2 again at 0.25 s, 6 twice,
# and a position that is in between; two cuts side by side share a moment. And positions stored in counts with a factor go in
# steps, up to a whole sample late, where those stored as floats go evenly: it looks at the stored type, not at what the values are.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check asammdf==8.8.28 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from asammdf import MDF, Signal

times = np.arange(10) / 10
recorded = MDF()
recorded.append(
    [
        Signal(np.arange(10, dtype=np.uint16), times, name="frame"),
        Signal(np.arange(10) * 1.5, times, name="mm"),
        Signal(np.arange(10, dtype=np.uint16) * 3, times, name="mm of counts", conversion={"a": 0.5, "b": 0.0}),
    ]
)
part = recorded.cut(start=0.25, stop=0.65)
frames = part.get("frame")
print("asammdf", version("asammdf"), "cut, times", frames.timestamps, "frames", frames.samples, "mm", part.get("mm").samples)
assert np.allclose(frames.timestamps, [0.25, 0.3, 0.4, 0.5, 0.6, 0.65]), "cut: the behaviour has changed"
assert frames.samples.tolist() == [2, 3, 4, 5, 6, 6], "cut: the behaviour has changed"
assert np.allclose(part.get("mm").samples[[0, -1]], [3.75, 9.75]), "cut: the behaviour has changed"
plain = recorded.cut(start=0.25, stop=0.65, include_ends=False).get("frame")
assert plain.samples.tolist() == [3, 4, 5, 6], "cut without ends: the behaviour has changed"
finer = recorded.resample(raster=0.05)
even, steps = finer.get("mm").samples[:6], finer.get("mm of counts").samples[:6]
print("every 50 ms, stored as floats", even, "as counts", steps)
assert np.array_equal(recorded.get("mm").samples, recorded.get("mm of counts").samples), "the behaviour has changed"
assert np.allclose(even, [0, 0.75, 1.5, 2.25, 3, 3.75]), "floats: the behaviour has changed"
assert np.allclose(steps, [0, 0, 1.5, 1.5, 3, 3]), "counts: the behaviour has changed"
PY
