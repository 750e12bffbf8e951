#!/usr/bin/env bash
# A good guess: evlib reads events from its own files as it wrote them, and, as its page says, with polarities of -1 and 1. Found: times, which
# its writers take in seconds, come back from text as they were, from HDF5 a million times smaller (2.25 s becomes 2 microseconds: what
# it wrote as seconds, it reads as microseconds), and polarities of 0 stay 0 from text and become -1 from HDF5.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check evlib==0.13.2 numpy==2.4.6
v/bin/python - 2>/dev/null <<'PY'
from datetime import timedelta
from importlib.metadata import version

import evlib
import numpy as np

times_s = np.array([2.25, 2.5, 2.75])
columns, rows, polarities = np.array([3, 4, 5]), np.array([6, 7, 8]), np.array([0, 1, 0])
evlib.save_events_to_text(columns, rows, times_s, polarities, "events.txt")
evlib.save_events_to_hdf5(columns, rows, times_s, polarities, "events.h5")
read = {name: evlib.load_events(f"events.{name}").collect() for name in ("txt", "h5")}
for name, events in read.items():
    print("evlib", version("evlib"), name, "times", events["t"].to_list(), "polarities", events["polarity"].to_list())
text, tables = read["txt"], read["h5"]
assert text["t"][0] == timedelta(seconds=2.25) and text["polarity"].to_list() == [0, 1, 0], "text: the behaviour has changed"
assert tables["t"][0] == timedelta(microseconds=2) and tables["polarity"].to_list() == [-1, 1, -1], "HDF5: the behaviour has changed"
PY
