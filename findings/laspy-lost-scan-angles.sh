#!/usr/bin/env bash
# A good guess: laspy.convert keeps what both point formats of LAS can hold, such as the angle of the scanner, which formats 0 to 5 count in
# degrees and 6 to 10 in steps of 0.006 degrees; and numbers that do not fit raise an error, as coordinates do. Found: all angles are 0 after a
# conversion from one group to the other, either way, without a word; set as degrees in format 6, 15 is 0.09 degrees; and intensities and
# colours come round: 70000 is 4464, and -1 is 65535, though a return number, a coordinate or a scaled extra dimension raises.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check laspy==2.7.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
import laspy
import numpy as np


def cloud(point_format, **fields):
    """Return three points of that format."""
    made = laspy.LasData(laspy.LasHeader(point_format=point_format, version="1.4"))
    made.xyz = np.zeros((3, 3))
    for name, values in fields.items():
        setattr(made, name, np.array(values))
    return made


old, new = cloud(1, scan_angle_rank=[15, -15, 90], intensity=[1, 2, 3]), cloud(6, scan_angle=[2500, -2500, 15000], intensity=[1, 2, 3])
there, back = laspy.convert(old, point_format_id=6), laspy.convert(new, point_format_id=1)
within = laspy.convert(old, point_format_id=3)
found = {
    "1 to 3": np.array(within.scan_angle_rank).tolist(),
    "1 to 6": np.array(there.scan_angle).tolist(),
    "6 to 1": np.array(back.scan_angle_rank).tolist(),
    "15 in 6": np.array(cloud(6, scan_angle=[15.0, 15, 15]).scan_angle).tolist(),
    "intensity": np.array(cloud(7, intensity=[70000, -1, 3]).intensity).tolist(),
    "red": np.array(cloud(7, red=[70000, -1, 3]).red).tolist(),
}
for name, values in found.items():
    print("laspy", laspy.__version__, name, values)
raised = []
for name, values in (("return_number", [16, 1, 1]), ("x", [1e9, 0, 0])):
    try:
        cloud(6, **{name: values})
    except OverflowError as error:
        raised.append(name)
        print(name, "of", values[0], "raises:", error)
assert found["1 to 3"] == [15, -15, 90] and np.array(there.intensity).tolist() == [1, 2, 3] and raised == ["return_number", "x"]
assert found["1 to 6"] == found["6 to 1"] == [0, 0, 0], "conversion: the behaviour has changed"
assert found["15 in 6"] == [15, 15, 15], "angles: the behaviour has changed"
assert found["intensity"] == found["red"] == [4464, 65535, 3], "numbers that do not fit: the behaviour has changed"
PY
