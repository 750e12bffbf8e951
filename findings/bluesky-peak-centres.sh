#!/usr/bin/env bash
# A good guess: after a scan, bluesky's PeakStats, on which its tables and automatic alignments rest, gives the peak by cen, "mid-point between
# half-max points", and by com. Found: of a peak whose second half lies beyond the end of the scan, cen is its one flank, 1.72 for 2.9; of two peaks
# the middle between, where there is nothing. com takes a constant background for mass, unless told of edges to fit it to: a
# peak at 0.4 on ten times its height is at 0.015; and steps of unlike size count alike, so that finer steps on one side draw it there: 0.91.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check bluesky==1.15.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from bluesky.callbacks.fitting import PeakStats


def found(places, counts, **chosen):
    """Return what is found of a run that measured these counts at these places."""
    stats = PeakStats("motor", "counts", **chosen)
    stats("start", {"uid": "run", "time": 0})
    stats("descriptor", {"uid": "stream", "run_start": "run", "time": 0, "data_keys": {}, "name": "primary"})
    for number, (place, count) in enumerate(zip(places, counts, strict=True), 1):
        data = {"motor": place, "counts": count}
        stats("event", {"descriptor": "stream", "uid": str(number), "seq_num": number, "time": 0, "data": data, "timestamps": {}})
    stats("stop", {"uid": "end", "run_start": "run", "time": 0})
    return {name: round(float(stats[name]), 3) for name in ("com", "cen")}


def peak(places, centre):
    return np.exp(-((places - centre) ** 2) / 2)


even = np.linspace(-3, 3, 25)
uneven = np.concatenate([np.linspace(-3, 0, 5), np.linspace(0.1, 3, 40)])
plain = found(even, peak(even, 0.4))
at_the_edge = found(even, peak(even, 2.9))
two = found(2 * even, peak(2 * even, -3) + peak(2 * even, 3))
on_light = found(even, peak(even, 0.4) + 10)
fitted = found(even, peak(even, 0.4) + 10, edge_count=2)
finer = found(uneven, peak(uneven, 0.4))
print("bluesky", version("bluesky"), "a peak at 0.4:", plain, "at 2.9 of a scan to 3:", at_the_edge, "at -3 and 3:", two)
print("at 0.4 on a background of 10:", on_light, "with edge_count=2:", fitted, "with finer steps on the right:", finer)
assert plain == {"com": 0.391, "cen": 0.401}, "the behaviour has changed"
assert at_the_edge["cen"] == 1.717 and two["cen"] == 0, "cen: the behaviour has changed"
assert on_light["com"] == 0.015 and finer["com"] == 0.909, "com: the behaviour has changed"
PY
