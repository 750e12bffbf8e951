#!/usr/bin/env bash
# A good guess: pyxdf gives the times that an XDF file of the Lab Streaming Layer holds, freed of jitter, and keeps pauses. Found: it lays
# one straight line through the times of all samples, unless a pause is longer than a second and than 500 samples. A camera of 100 frames a
# second that stood for 4 s is said to have run on at 77 frames a second: half of all times are wrong by 0.75 s or more, the worst by two.
# If from the middle on every other frame is lost, it is up to 2.2 s. Read with dejitter_timestamps=False, times are as they were written.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyxdf==1.17.5 numpy==2.4.6
v/bin/python - <<'PY'
import logging
import struct
from importlib.metadata import version

import numpy as np
import pyxdf

logging.disable(logging.WARNING)
RATE = 100


def chunk(kind, content):
    return b"\x04" + struct.pack("<IH", len(content) + 2, kind) + content


def write(times):
    """Write a stream of one channel, the frame's number, with its time beside each."""
    stream = struct.pack("<I", 1)
    about = (
        "<?xml version='1.0'?><info><name>camera</name><type>frames</type><channel_count>1</channel_count>"
        f"<nominal_srate>{RATE}</nominal_srate><channel_format>int32</channel_format></info>"
    )
    samples = b"".join(b"\x08" + struct.pack("<di", *sample) for sample in zip(times, range(len(times)), strict=True))
    end = f"<?xml version='1.0'?><info><first_timestamp>{times[0]}</first_timestamp><last_timestamp>{times[-1]}</last_timestamp></info>"
    with open("run.xdf", "wb") as file:
        file.write(b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>"))
        file.write(chunk(2, stream + about.encode()))
        file.write(chunk(3, stream + b"\x04" + struct.pack("<I", len(times)) + samples))
        file.write(chunk(6, stream + end.encode()))


def errors(times, **chosen):
    write(times)
    (stream,), _ = pyxdf.load_xdf("run.xdf", **chosen)
    assert stream["time_series"][:, 0].tolist() == list(range(len(times)))
    return np.abs(stream["time_stamps"] - times), stream["info"]["effective_srate"]


ticks = 100 + np.arange(2000) / RATE
paused = {seconds: np.where(np.arange(2000) < 1000, ticks, ticks + seconds) for seconds in (4, 5.5)}
steady, _ = errors(ticks)
wrong, rate = errors(paused[4])
longer, _ = errors(paused[5.5])
as_written, _ = errors(paused[4], dejitter_timestamps=False)
lost, _ = errors(np.concatenate([ticks[:1000], ticks[1000::2]]))
print(f"pyxdf {version('pyxdf')}: a pause of 4 s: {rate:.1f} frames/s, wrong by {np.median(wrong):.2f} s in the median, at most {wrong.max():.2f} s")
print(f"a pause of 5.5 s: {longer.max():.6f} s; every other frame lost: {lost.max():.2f} s; no pause: {steady.max():.6f} s")
assert max(steady.max(), longer.max(), as_written.max()) < 1e-6, "the behaviour has changed"
assert round(rate, 1) == 76.9 and round(wrong.max(), 2) == 2.0 and round(np.median(wrong), 2) == 0.75, "a pause: the behaviour has changed"
assert round(lost.max(), 2) == 2.22, "lost frames: the behaviour has changed"
PY
