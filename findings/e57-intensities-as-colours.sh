#!/usr/bin/env bash
# A good guess: the Python package e57 gives a scan's colours in `color` and its intensities in `intensity`, and neither where the file has none.
# Found: intensities of a scan without colours are its colours too, as they stand: red, green and blue of 2047, while true colours lie in 0..1. If one
# scan of several has no intensities, those of all are gone, while their points and such colours are there in one array. If one point is marked as
# invalid, as scanners mark each sky, the others have neither colours nor intensities. pye57 tells them apart.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check e57==0.2.3 pye57==0.4.19 numpy==2.4.6
cat > look.py <<'PY'
from importlib.metadata import version

import e57
import numpy as np
import pye57

grey = {"intensity": np.array([100.0, 1000.0, 2047.0])}
coloured = {f"color{name}": np.full(3, value, np.uint8) for name, value in (("Red", 255), ("Green", 51), ("Blue", 0))}


def write(path, *scans):
    file = pye57.E57(path, mode="w")
    for i, fields in enumerate(scans):
        places = {f"cartesian{axis}": np.arange(3.0) + 10 * i for axis in "XYZ"}
        file.write_scan_raw({**places, **fields})
    file.close()
    return e57.read_points(path)


alone = write("grey.e57", grey)
both = write("both.e57", grey, coloured)
marked = [write(f"{state}.e57", {**grey, **coloured, "cartesianInvalidState": np.array([0, 0, state], np.uint8)}) for state in (0, 2)]
print("e57", version("e57"), "of a scan with intensities alone: color", alone.color.tolist(), "intensity", alone.intensity.ravel().tolist())
print("with a second scan of colours: points", both.points.shape, "color", both.color.tolist(), "intensity", both.intensity.shape)
for name, each in zip(("valid", "invalid"), marked):
    print("of a coloured scan whose last point is marked", name, "points", each.points.shape, "color", each.color.shape, "intensity", each.intensity.shape)
file = pye57.E57("grey.e57")
fields = file.get_header(0).point_fields
assert "intensity" in fields and "colorRed" not in fields
assert file.read_scan(0, intensity=True, ignore_missing_fields=True)["intensity"].tolist() == [100, 1000, 2047]
assert alone.intensity.ravel().tolist() == [100, 1000, 2047]
assert alone.color.tolist() == [[100] * 3, [1000] * 3, [2047] * 3], "the behaviour has changed"
assert both.points.shape == (6, 3) and np.allclose(both.color[3:], [1, 0.2, 0])
assert both.color[:3].tolist() == alone.color.tolist(), "the behaviour has changed"
assert both.intensity.size == 0, "the behaviour has changed"
assert marked[0].color.shape == (3, 3) and marked[0].intensity.size == 3
assert pye57.E57("2.e57").read_scan(0, intensity=True, colors=True)["colorRed"].tolist() == [255, 255]
assert marked[1].points.shape == (2, 3) and marked[1].color.size == marked[1].intensity.size == 0, "invalid points: the behaviour has changed"
PY
v/bin/python look.py
