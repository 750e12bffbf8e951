#!/usr/bin/env bash
# A good guess: lecroyparser gives the samples of a LeCroy oscilloscope's file the times that the file has: one horizontal interval apart, and in
# sequence mode, where each trigger starts a segment, from each segment's own time on. Found: it stretches the times so that the last sample
# is one interval late: 5 points every ms are 1.25 ms apart. Segments are glued: a second one a minute later follows at once, and the
# table of triggers is skipped. lecroyutils reads that table, and stretches within each segment.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps lecroyparser==1.4.2 lecroyutils==4.0.2 numpy==2.4.6
v/bin/python - <<'PY'
import struct
from importlib.metadata import version
from importlib.util import module_from_spec, spec_from_file_location, find_spec
from pathlib import Path

import numpy as np
from lecroyparser import ScopeData

INTERVAL, GAIN, POINTS = 2**-10, 0.5, 5


def write(name, triggers):
    """Write one segment of POINTS counts, from 0 on, for each trigger's time, as the template LECROY_2_3 has them."""
    counts = np.arange(POINTS * len(triggers), dtype="<i2").tobytes()
    table = b"".join(struct.pack("<2d", seconds, 0.0) for seconds in triggers) if len(triggers) > 1 else b""
    head = bytearray(346)
    head[0:8], head[16:26], head[76:84], head[196:197], head[244:245] = b"WAVEDESC", b"LECROY_2_3", b"LECROYXX", b"V", b"S"
    samples = POINTS * len(triggers)
    for place, kind, values in (
        (32, "hhi", (1, 1, len(head))),  # two bytes a count, the lower first
        (48, "i", (len(table),)),
        (60, "i", (len(counts),)),
        (116, "iiii", (samples, samples, 0, samples - 1)),
        (144, "i", (len(triggers),)),
        (156, "ffff", (GAIN, 0.0, 32767.0, -32768.0)),
        (172, "hhfd", (12, len(triggers), INTERVAL, 0.0)),
        (296, "dBBBBh", (7.5, 34, 12, 30, 11, 2030)),
        (324, "hh", (20, 2)),
    ):
        struct.pack_into("<" + kind, head, place, *values)
    Path(name).write_bytes(b"#9%09d" % (len(head) + len(table) + len(counts)) + head + table + counts)


def times_by_lecroyutils(name):
    """Return a row of times for each segment; its module of files alone, since the package asks for what talks to oscilloscopes."""
    spec = spec_from_file_location("data", Path(find_spec("lecroyutils").submodule_search_locations[0], "data.py"))
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.LecroyScopeData.parse_file(name).x.T


write("one.trc", [0.0])
write("two.trc", [0.0, 60.0])
one, two, other = ScopeData("one.trc"), ScopeData("two.trc"), times_by_lecroyutils("two.trc")
print("lecroyparser", version("lecroyparser"), "intervals between", POINTS, "points:", np.diff(one.x) / INTERVAL)
print("two triggers a minute apart: samples", two.y, "the last at", two.x[-1], "s; lecroyutils:", other.round(4).tolist())
assert np.array_equal(one.y, GAIN * np.arange(POINTS)), "values: the behaviour has changed"
assert np.allclose(np.diff(one.x), 1.25 * INTERVAL), "times: the behaviour has changed"
assert len(two.x) == 10 and np.isclose(two.x[-1], 10 * INTERVAL), "segments: the behaviour has changed"
assert np.allclose(other[1] - 60, one.x), "lecroyutils: the behaviour has changed"
PY
