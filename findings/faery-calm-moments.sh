#!/usr/bin/env bash
# A good guess: faery reads the EVT3 file (.raw) of an event camera that it has written with the times that it was given. Found: the format counts 16.78 s in
# 24 bits, and faery's reader knows that a round is over only by the last 4 ms of it: if no event falls into these, as in a calm scene, the times
# stop there, for events of a new round are set to the last time before: of 40 s with an event each 10 ms, 58 % are at six moments, the last 23 s
# too early. A reader that takes each fall of the upper half for a new round has the file right. EVT2 and CSV come back right. DAT files
# count from 0 again after 71 minutes, without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps faery==0.7.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import faery
import numpy as np


def events(times):
    """Return events at those microseconds."""
    made = np.zeros(len(times), dtype=faery.EVENTS_DTYPE)
    made["t"], made["x"], made["y"] = times, np.arange(len(times)) % 640, np.arange(len(times)) % 480
    return made


def there_and_back(times, name, **named):
    """Return the times that come back."""
    faery.events_stream_from_array(events(times), (640, 480)).to_file(name, **named)
    return np.concatenate([part["t"] for part in faery.events_stream_from_file(name)]).astype(np.int64)


def read_plainly(name):
    """Return the times in an EVT3 file, by the upper (8) and the lower half (6) of its times, at each event (2)."""
    body = Path(name).read_bytes()
    while body.startswith(b"%"):
        body = body[body.index(b"\n") + 1 :]
    times, rounds, upper, lower = [], 0, 0, 0
    for word in np.frombuffer(body[: len(body) // 2 * 2], "<u2").tolist():
        kind, value = word >> 12, word & 0xFFF
        if kind == 8:
            rounds += value < upper
            upper = value
        elif kind == 6:
            lower = value
        elif kind == 2:
            times.append((rounds << 24) + (upper << 12) + lower)
    return np.array(times)


found = {}
for step in (1000, 10_000, 25_000):
    times = np.arange(0, 40_000_000, step)
    back = there_and_back(times, "film.raw", version="evt3")
    wrong = back != times
    plain = read_plainly("film.raw")
    others = {name: bool((there_and_back(times, name, **named) == times).all()) for name, named in (("film.csv", {}), ("two.raw", {"version": "evt2"}))}
    found[step] = float(wrong.mean()), len(np.unique(back[wrong])), float(back[-1] - times[-1]) / 1e6, bool((plain == times).all()), all(others.values())
    print("faery", version("faery"), f"an event each {step / 1000:g} ms for 40 s: {found[step][0]:.0%} come back at {found[step][1]} other moments, the last {found[step][2]:+.2f} s; read plainly right: {found[step][3]}; CSV and EVT2 right: {found[step][4]}")
late = there_and_back(np.array([1000, 4_294_968_296]), "film.dat").tolist()
print("DAT: 1000 and 4294968296 us are", late)
assert found[1000][0] == 0 and all(values[3] and values[4] for values in found.values())
assert abs(found[10_000][0] - 0.58) < 0.01 and found[10_000][1] == 6 and found[10_000][2] < -20, "the behaviour has changed"
assert found[25_000][0] > 0.5 and found[25_000][1] < 20, "the behaviour has changed"
assert late == [1000, 1000], "DAT: the behaviour has changed"
PY
